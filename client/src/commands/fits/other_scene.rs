//! Notes that a session is measured with a dictionary of another scene.

use farm_lab::measurement_file::Note;
use optics_model::Scene;

/// `None` if all quantities are equal.
pub(super) fn note(dictionary: &str, session: &Scene, other: &Scene) -> Option<Note> {
    let differences = session.differences(other);
    let list: Vec<String> =
        differences.iter().map(|d| format!("{} {} instead of {}", d.quantity, d.other, d.own)).collect();
    (!list.is_empty()).then(|| Note {
        code: "SCENE_DIFFERS",
        text: format!(
            "dictionary {dictionary} has another scene than the session: {}; without --dictionary the session's own is \
             used",
            list.join("; ")
        ),
    })
}

#[cfg(test)]
mod tests {
    use optics_model::scene::Prior;

    use super::*;

    /// The note names the quantity, with the values of both scenes.
    #[test]
    fn note_has_both_values_of_a_prior() {
        let lab = Scene::lab();
        let halved = |prior: &Prior| {
            let half = 0.5 * prior.std_error();
            Prior::new(prior.kind(), prior.layers().to_vec(), half, prior.scope()).unwrap()
        };
        let mut priors = lab.priors().to_vec();
        let gel = priors.iter_mut().find(|prior| lab.name_of(prior) == "gel thickness").unwrap();
        *gel = halved(gel);
        let session = lab.clone().with_priors(priors).unwrap();
        let found = note("lab", &session, &lab).unwrap();
        assert_eq!(
            found.text,
            "dictionary lab has another scene than the session: gel thickness 0.02 ± 0.02 mm per slab instead of 0.02 ± \
             0.01 mm per slab; without --dictionary the session's own is used"
        );
        assert_eq!(note("lab", &lab, &lab), None);
    }
}
