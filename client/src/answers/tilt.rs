//! Notes that edges lie the farther off the thicker their slabs are, as a camera sees them that is tilted across the edge.
//!
//! Under a tilt of θ a slab of thickness t and index n shifts the edge by t tan(asin(sin θ / n)). Other reasons for shifts
//! do not follow thickness, so their scatter about a straight line is the error of its slope.

use farm_figures::numbers::significant;
use farm_lab::measurement_file::Note;
use optics_model::fit::{MaterialFit, Nuisance};

/// Index of slabs, for the angle that is stated.
const INDEX: f64 = 1.5;
/// Least tilt in degrees that is noted: it moves σ_a by a few per cent.
const LEAST_DEG: f64 = 1.5;
/// Error of an edge's place in mm, at least.
const EDGE_MM: f64 = 0.003;
/// Standard errors of the slope from which on it is noted, with f degrees of freedom 3.29 e^(4/f): Student's t of 0.1 % from
/// 3 on, to a tenth.
const NORMAL: f64 = 3.29;

/// A note if the edges of slabs shift with their thickness.
pub(super) fn tilt(fits: &[MaterialFit]) -> Option<Note> {
    let tilt_deg = tilt_deg(&fits.iter().flat_map(shifts).collect::<Vec<_>>())?;
    Some(Note {
        code: "TILTED_CAMERA",
        text: format!(
            "the edges of slabs lie the farther off the thicker the slabs are, as for a camera that is tilted by about {}° \
             across the edge: σ_a may be off by 20 %; look along the normal of the board",
            significant(tilt_deg.abs(), 1)
        ),
    })
}

/// Thickness and shift of the edge of each slab, the mean of its channels.
fn shifts(fit: &MaterialFit) -> Vec<[f64; 2]> {
    let channels = fit.channels.iter().filter_map(|channel| channel.refined.as_ref());
    let origins = channels.flat_map(|r| &r.likelihood.nuisances).filter(|n| n.nuisance == Nuisance::Origin);
    let mut slabs: Vec<(f64, Vec<f64>)> = Vec::new();
    for (mm, shift) in origins.filter_map(|n| Some((n.profile_mm?, n.value - n.prior))) {
        match slabs.iter_mut().find(|(of, _)| *of == mm) {
            Some((_, shifts)) => shifts.push(shift),
            None => slabs.push((mm, vec![shift])),
        }
    }
    slabs.into_iter().map(|(mm, shifts)| [mm, shifts.iter().sum::<f64>() / shifts.len() as f64]).collect()
}

/// The tilt in degrees that these thicknesses and shifts show; none if it is not significant.
fn tilt_deg(slabs: &[[f64; 2]]) -> Option<f64> {
    let n = slabs.len() as f64;
    let mean = |k: usize| slabs.iter().map(|slab| slab[k]).sum::<f64>() / n;
    let (mm, shift) = (mean(0), mean(1));
    let spread: f64 = slabs.iter().map(|slab| (slab[0] - mm).powi(2)).sum();
    if n < 4.0 || spread == 0.0 {
        return None;
    }
    let slope = slabs.iter().map(|slab| (slab[0] - mm) * (slab[1] - shift)).sum::<f64>() / spread;
    let squares: f64 = slabs.iter().map(|slab| (slab[1] - shift - slope * (slab[0] - mm)).powi(2)).sum();
    let std_error = (squares / (n - 2.0)).sqrt().max(EDGE_MM) / spread.sqrt();
    let is_significant = slope.abs() > NORMAL * libm::exp(4.0 / (n - 2.0)) * std_error;
    let tilt_deg = libm::asin((INDEX * libm::sin(libm::atan(slope))).clamp(-1.0, 1.0)).to_degrees();
    (is_significant && tilt_deg.abs() > LEAST_DEG).then_some(tilt_deg)
}

#[cfg(test)]
mod tests {
    use farm_figures::testing;
    use optics_model::fit::NuisanceEstimate;

    use super::*;

    /// Slabs of 0.5 and 1 mm of some materials in two channels, with shifts of their edges in mm.
    fn session(shifts: &[[f64; 2]]) -> Vec<MaterialFit> {
        let material = |shifts: &[f64; 2]| {
            let mut channel = testing::channel("R", 6.0, 1.0);
            let origin = |(mm, value): (f64, &f64)| NuisanceEstimate {
                nuisance: Nuisance::Origin,
                profile_mm: Some(mm),
                value: *value,
                std_error: 0.002,
                prior: 0.0,
                prior_std_error: 0.05,
            };
            channel.refined.as_mut().unwrap().likelihood.nuisances =
                [0.5, 1.0].into_iter().zip(shifts).map(origin).collect();
            MaterialFit { material: "white".into(), channels: vec![channel.clone(), channel] }
        };
        shifts.iter().map(material).collect()
    }

    /// Under 5° edges shift by 0.029 and 0.058 mm. Shifts that do not follow thickness, or of one material alone, are none.
    #[test]
    fn shifts_with_thickness_are_a_tilt() {
        let text = tilt(&session(&[[0.031, 0.057], [0.028, 0.060], [0.029, 0.059]])).unwrap().text;
        assert!(text.contains("tilted by about 5° across"), "{text}");
        let scattered = [[0.03, 0.06], [0.05, -0.02], [-0.04, 0.05], [0.02, 0.03]];
        for shifts in [&scattered[..], &[[0.03, 0.06]], &[[0.05, 0.05]; 4], &[[0.001, 0.004]; 4]] {
            assert_eq!(tilt(&session(shifts)), None, "{shifts:?}");
        }
    }
}
