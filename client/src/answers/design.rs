//! A comparison of sets of slabs to photograph.

use farm_figures::numbers::{albedo, significant, slabs};
use farm_lab::document::{Block, ValueTable};
use optics_model::Medium;
use optics_model::fit::{Design, DesignQuestion, HalfWidths, Improvement, Limitation, SlabSet};

/// Two tables, g held and g free, and the limits of the best set.
pub(crate) fn design_blocks(design: &Design, question: &DesignQuestion) -> Vec<Block> {
    let mut blocks = vec![Block::Paragraph(head(design, question))];
    blocks.extend(held(design));
    if design.sets.iter().any(|set| set.g_free.is_some()) {
        blocks.extend(free(design));
    }
    blocks.push(Block::heading(3, "Limits"));
    blocks.extend(limits(design).into_iter().map(Block::Paragraph));
    blocks
}

fn head(design: &Design, question: &DesignQuestion) -> String {
    let (m, s) = (&design.medium, question.settings());
    let medium = format!(
        "Channel {}, guess σ_t = {} /mm, α = {}, g = {}; {} % and {} of noise in each of {} pixels.",
        design.channel,
        m.sigma_t_per_mm(),
        albedo(m.albedo()),
        m.g(),
        significant(100.0 * s.noise, 3),
        s.noise_floor,
        design.pixels.count(),
    );
    let mu = if s.mu_free { " The factor μ is determined by the photographs alone." } else { "" };
    let what = "Below are the least half-widths of 95 % intervals that any fit without bias can have \
                (Cramér–Rao bound)";
    let uncertain = |i: &Improvement| i.limitation == Limitation::Scene;
    let scene = if design.sets.iter().flat_map(|set| &set.improvements).any(uncertain) {
        "with the uncertain quantities of the dictionary's scene as unknowns"
    } else {
        "with the dictionary's scene taken as exact"
    };
    format!("{medium}{mu} {what}, {scene}.")
}

fn held(design: &Design) -> [Block; 2] {
    let m = &design.medium;
    let row = |set: &SlabSet| {
        let w = &set.g_held;
        let limited = limit(set, m, HalfWidths::of_sigma_t).map_or("–", name);
        let mut row = vec![slabs(set), set.shots.to_string()];
        row.extend(shares(w, m).map(percent));
        row.extend([limited.to_owned(), best_for(set)]);
        row
    };
    let head = "slabs\nmm | >shots | >σ_t\n± % | >1−α\n± % | >σ_s(1−g)\n± % | >σ_a\n± % | \
                σ_t is\nlimited by | >best for\nphotographs";
    let title = Block::Heading(3, format!("g held at {}", m.g()));
    [title, ValueTable::new(head, design.sets.iter().map(row)).block()]
}

fn free(design: &Design) -> [Block; 2] {
    let m = &design.medium;
    let row = |set: &SlabSet| {
        let w = set.g_free.unwrap_or(HalfWidths::UNKNOWN);
        let mut row = vec![slabs(set), set.shots.to_string()];
        row.extend(shares(&w, m).map(percent));
        row.push(if w.g < 1.0 { significant(w.g, 2) } else { "> 1".to_owned() });
        row
    };
    let head = "slabs\nmm | >shots | >σ_t\n± % | >1−α\n± % | >σ_s(1−g)\n± % | >σ_a\n± % | >g\n±";
    [Block::heading(3, "g free"), ValueTable::new(head, design.sets.iter().map(row)).block()]
}

fn shares(w: &HalfWidths, m: &Medium) -> [f64; 4] {
    [w.of_sigma_t(m), w.of_co_albedo(m), w.of_reduced_scattering(m), w.of_absorption(m)]
}

fn percent(share: f64) -> String {
    match share {
        0.0 => "known".to_owned(),
        v if v < 1.0 => significant(100.0 * v, 2),
        _ => "> 100".to_owned(),
    }
}

/// The number of photographs for which a set is the best.
fn best_for(set: &SlabSet) -> String {
    match (set.best, set.best_of_its_effort) {
        (true, _) => "any".to_owned(),
        (false, true) => set.photographs().to_string(),
        _ => String::new(),
    }
}

/// Half-width of a quantity relative to its value.
type RelativeShare = fn(&HalfWidths, &Medium) -> f64;

/// The improvement that reduces a half-width most.
fn limit<'a>(set: &'a SlabSet, medium: &Medium, share: RelativeShare) -> Option<&'a Improvement> {
    let left = |i: &Improvement| share(&i.best(), medium);
    let finite = set.improvements.iter().filter(|i| left(i).is_finite());
    finite.min_by(|a, b| left(a).total_cmp(&left(b)))
}

fn name(improvement: &Improvement) -> &str {
    match improvement.limitation {
        Limitation::Scene => improvement.quantity.as_deref().unwrap_or("scene"),
        Limitation::Noise => "noise",
        Limitation::Thickness => "thickness",
        Limitation::Origin => "origin",
        Limitation::Blur => "blur",
        Limitation::Gain => "gain",
        Limitation::Zero => "zero",
        Limitation::Slope => "slope",
        Limitation::Wedge => "wedge",
        Limitation::Scale => "μ",
    }
}

/// The most effective improvements of the best set, or a message that no set determines the medium.
fn limits(design: &Design) -> Vec<String> {
    let Some(best) = design.sets.iter().find(|set| set.best) else {
        return vec!["No set determines σ_t and the albedo, even with g held.".to_owned()];
    };
    let photographs = match best.shots {
        1 => "one photograph".to_owned(),
        n => format!("{n} photographs"),
    };
    let mut lines = vec![format!("Best: {} mm, {photographs} of each slab.", slabs(best))];
    let quantities: [(&str, RelativeShare); 2] =
        [("σ_t", HalfWidths::of_sigma_t), ("1 − α", HalfWidths::of_co_albedo)];
    for (quantity, share) in quantities {
        if let Some(improvement) = limit(best, &design.medium, share) {
            let percent_text = |widths: &HalfWidths| percent(share(widths, &design.medium));
            lines.push(what_limits(quantity, improvement, &best.g_held, percent_text));
        }
    }
    lines.extend(scene(best, &design.medium));
    lines.extend(estimated(best));
    lines
}

/// The scene's quantities in the order in which to measure them, the most effective first. `None` if the scene is exact.
fn scene(set: &SlabSet, medium: &Medium) -> Option<String> {
    let mut known: Vec<(&str, f64)> = set
        .improvements
        .iter()
        .filter(|i| i.limitation == Limitation::Scene)
        .map(|i| (name(i), HalfWidths::of_sigma_t(&i.best(), medium)))
        .collect();
    known.sort_by(|a, b| a.1.total_cmp(&b.1));
    let each = |(name, share): &(&str, f64)| format!("{name} ± {} %", percent(*share));
    let now = percent(set.g_held.of_sigma_t(medium));
    let text = known.iter().map(each).collect::<Vec<_>>().join(", ");
    (!known.is_empty())
        .then(|| format!("Of the set-up measure first (σ_t is ± {now} %; with the quantity known): {text}."))
}

/// Ratio of standard errors from which on that with g free is listed, too.
const WORSE: f64 = 1.1;

/// The scene's quantities that these photographs determine better than their priors by a tenth at least.
fn estimated(set: &SlabSet) -> Option<String> {
    let each = |i: &Improvement| {
        let (prior, found) = (i.std_error?, i.estimated?);
        let number = |std_error: f64| with_unit(i, std_error);
        let worse = i.estimated_g_free.filter(|free| *free > WORSE * found);
        let free = worse.map(|free| format!(", {} with g free", number(free))).unwrap_or_default();
        (found < 0.9 * prior)
            .then(|| format!("{} ± {} (prior {}{free})", name(i), number(found), number(prior)))
    };
    let all: Vec<String> = set.improvements.iter().filter_map(each).collect();
    (!all.is_empty()).then(|| format!("The photographs determine, with g held: {}.", all.join("; ")))
}

/// "σ_t is limited by the thickness: ± 1 %; with 0.0025 mm instead of 0.005 mm ± 0.7 %, if known exactly ± 0.6 %."
fn what_limits(
    quantity: &str,
    improvement: &Improvement,
    now: &HalfWidths,
    of: impl Fn(&HalfWidths) -> String,
) -> String {
    let limitation = improvement.limitation;
    let mut text = format!("{quantity} is limited by the {}: ± {} %", name(improvement), of(now));
    if limitation == Limitation::Noise {
        let halved = improvement.halved.as_ref().map_or("–".to_owned(), of);
        return format!("{text}; with four times the shots ± {halved} %.");
    }
    if let (Some(std_error), Some(halved)) = (improvement.std_error, &improvement.halved) {
        let (half, whole) = (with_unit(improvement, 0.5 * std_error), with_unit(improvement, std_error));
        text += &format!("; with a standard error of {half} instead of {whole} ± {} %", of(halved));
    }
    if let Some(removed) = &improvement.removed {
        text += &format!("; if it were known exactly ± {} %", of(removed));
    }
    text + "."
}

/// A standard error in the unit of its quantity.
fn with_unit(improvement: &Improvement, std_error: f64) -> String {
    let number = |factor: f64| significant(factor * std_error, 3);
    match improvement.limitation {
        Limitation::Scene => format!("{} {}", number(1.0), improvement.unit.as_deref().unwrap_or_default())
            .trim_end()
            .to_owned(),
        Limitation::Thickness | Limitation::Origin | Limitation::Blur => format!("{} µm", number(1e3)),
        Limitation::Noise | Limitation::Gain => format!("{} %", number(100.0)),
        Limitation::Slope | Limitation::Wedge => format!("{} % per 10 mm", number(100.0)),
        Limitation::Zero | Limitation::Scale => number(1.0),
    }
}

#[cfg(test)]
mod tests {
    use farm_figures::testing::design;

    use super::*;

    /// Something to improve of the scene, with what the photographs add to its prior.
    fn of_scene(name: &str, unit: &str, [prior, estimated]: [f64; 2], g_free: Option<f64>) -> Improvement {
        Improvement {
            limitation: Limitation::Scene,
            quantity: Some(name.to_owned()),
            unit: Some(unit.to_owned()),
            std_error: Some(prior),
            halved: None,
            removed: None,
            estimated: Some(estimated),
            estimated_g_free: g_free,
        }
    }

    /// Quantities of the scene are listed with what the photographs add to their priors.
    #[test]
    fn determined_quantities_are_listed() {
        let mut set = design().sets.remove(0);
        set.improvements = vec![
            of_scene("gel thickness", "mm", [0.02, 0.004], None),
            of_scene("ring angle", "°", [1.0, 0.95], None),
            of_scene("sample second lobe weight", "", [0.05, 0.012], Some(0.03)),
        ];
        let expected = "The photographs determine, with g held: gel thickness ± 0.004 mm (prior 0.02 mm); \
                        sample second lobe weight ± 0.012 (prior 0.05, 0.03 with g free).";
        assert_eq!(estimated(&set).unwrap(), expected);
    }

    /// Limitations are given in practical units such as µm and per cent.
    #[test]
    fn limitations_have_practical_units() {
        for (limitation, std_error, expected) in [
            (Limitation::Scene, 0.02, "0.02 mm"),
            (Limitation::Blur, 0.03, "30 µm"),
            (Limitation::Gain, 0.003, "0.3 %"),
            (Limitation::Slope, 0.002, "0.2 % per 10 mm"),
            (Limitation::Zero, 0.001, "0.001"),
        ] {
            let improvement = Improvement { limitation, ..of_scene("", "mm", [0.0; 2], None) };
            assert_eq!(with_unit(&improvement, std_error), expected);
        }
    }
}
