//! Notes on the dictionary of a measurement: that it has another scene than the session, lacks a quantity that the session
//! has measured, or has too few walks for intervals.

use farm_lab::measurement_file::Note;
use optics_model::fit::FitSettings;
use optics_model::grid::NoiseLevel;
use optics_model::scene::{Prior, PriorKind, Scope};
use optics_model::{Grid, Scene};

/// Least share of the walks of the paper's quality with which intervals of estimated set-ups hold.
const ENOUGH_WALKS: f64 = 0.9;

/// A note if a dictionary whose scene is estimated has fewer walks than the paper's quality: −2 ln L then has several
/// minima, and an interval is about one of them.
pub(super) fn few_walks(dictionary: &str, grid: &Grid) -> Option<Note> {
    let paper = grid.clone().with_effort(NoiseLevel::Paper).ok()?;
    let [own, enough] = [grid, &paper].map(|grid| grid.least_and_most_walks()[1].get());
    let few = (own as f64) < ENOUGH_WALKS * enough as f64;
    (few && grid.quality().is_none() && grid.responses().is_some()).then(|| Note {
        code: "FEW_WALKS",
        text: format!(
            "dictionary {dictionary} has {own} walks for its thickest sample: with fewer than {enough}, those of quality \
             paper, intervals with an estimated set-up may be too narrow and g far off"
        ),
    })
}

/// A note if the scene of a dictionary differs from the session's.
pub(super) fn other_scene(dictionary: &str, session: &Scene, other: &Scene) -> Option<Note> {
    let differences = session.differences(other);
    let list: Vec<String> =
        differences.iter().map(|d| format!("{} {} instead of {}", d.quantity, d.other, d.own)).collect();
    (!list.is_empty()).then(|| Note {
        code: "SCENE_DIFFERS",
        text: format!(
            "dictionary {dictionary} has another scene than the session: {}; without --dictionary that of its set-up is \
             used",
            list.join("; ")
        ),
    })
}

/// A note if a session has measured quantities that the scene of a dictionary has with another value, two standard errors
/// off, and does not estimate.
pub(super) fn unused_quantities(dictionary: &str, scene: &Scene, settings: &FitSettings) -> Option<Note> {
    let unused = |kind: PriorKind| {
        let [value, std_error] = settings.measured(kind)?;
        let taken = scene.value_of(&Prior::new(kind, Vec::new(), std_error, Scope::Session).ok()?)?;
        let is_off = (value - taken).abs() > 2.0 * std_error;
        let is_estimated = scene.priors().iter().any(|prior| prior.kind() == kind);
        (is_off && !is_estimated).then(|| format!("{} {value} instead of {taken}", kind.name()))
    };
    let list: Vec<String> = PriorKind::OF_SESSION.into_iter().filter_map(unused).collect();
    (!list.is_empty()).then(|| Note {
        code: "UNUSED_QUANTITIES",
        text: format!(
            "the session has measured {}, which dictionary {dictionary} does not know: media may be far off; use one whose \
             scene has it, such as lab",
            list.join("; ")
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A spread that was measured is of no use to the scene of the paper; `lab` estimates it, and none is none.
    #[test]
    fn unused_measured_quantities_are_noted() {
        let note = |scene: &Scene, spread| {
            let mut settings = FitSettings::default();
            settings.measured[0] = Some([spread, 0.003]);
            unused_quantities("mine", scene, &settings)
        };
        let text = note(&Scene::paper(), 0.05).unwrap().text;
        assert!(text.starts_with("the session has measured base spread 0.05 instead of 0, which"), "{text}");
        assert_eq!((note(&Scene::paper(), 0.004), note(&Scene::lab(), 0.05)), (None, None));
    }

    /// Drafts of a scene that is estimated are noted; those of an exact scene and of the paper's quality are not.
    #[test]
    fn drafts_of_estimated_scenes_are_noted() {
        let lab = farm_lab::grid_file::named_grid("lab").unwrap();
        assert_eq!(few_walks("lab", &lab), None);
        let draft = lab.with_effort(NoiseLevel::Draft).unwrap();
        let note = few_walks("mine", &draft).unwrap();
        assert_eq!(note.code, "FEW_WALKS");
        assert!(note.text.starts_with("dictionary mine has 5500 walks"), "{}", note.text);
        assert_eq!(few_walks("paper", &Grid::paper().with_effort(NoiseLevel::Draft).unwrap()), None);
    }
}
