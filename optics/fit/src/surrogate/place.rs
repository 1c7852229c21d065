//! Locates a question in a dictionary, and refuses what the dictionary does not cover.

use optics_model::fit::PixelRow;
use optics_model::{Grid, Invalid, Medium};

use crate::dictionary::axes::list;
use crate::surrogate::Surrogate;

/// Index of a sample's refractive index; the first if none is given.
pub(crate) fn sample_ior(grid: &Grid, wanted: Option<f64>) -> Result<usize, Invalid> {
    let Some(wanted) = wanted else { return Ok(0) };
    let found = grid.sample_ior().iter().position(|ior| (ior - wanted).abs() < 1e-9);
    let allowed = || format!("the dictionary has {}", list(grid.sample_ior()));
    found.ok_or_else(|| Invalid::new("sample_ior", wanted, allowed()))
}

/// Checks that a medium lies between those of the dictionary.
pub(crate) fn check_medium(grid: &Grid, medium: &Medium) -> Result<(), Invalid> {
    for (field, value, axis) in axes(grid, medium) {
        let (least, greatest) = (axis[0], axis[axis.len() - 1]);
        if !(least..=greatest).contains(&value) {
            let allowed = if least == greatest {
                format!("the dictionary has {least} only")
            } else {
                format!("the dictionary reaches from {least} to {greatest}")
            };
            return Err(Invalid::new(field, value, allowed));
        }
    }
    Ok(())
}

/// The parameters of a medium, with the dictionary's values of each.
pub(crate) fn axes<'a>(grid: &'a Grid, medium: &Medium) -> [(&'static str, f64, &'a [f64]); 3] {
    [
        ("sigma_t_per_mm", medium.sigma_t_per_mm(), grid.sigma_t_per_mm()),
        ("albedo", medium.albedo(), grid.albedo()),
        ("g", medium.g(), grid.g()),
    ]
}

/// The dictionary's pixels.
pub(crate) fn own_pixels(grid: &Grid) -> Result<PixelRow, Invalid> {
    let sensor = grid.scene().sensor();
    let half = 0.5 * sensor.width_mm();
    PixelRow::new(-half, half, sensor.pitch_mm())
}

/// Checks that a medium can be predicted at a thickness.
pub(crate) fn check_thickness(
    surrogate: &Surrogate,
    medium: &Medium,
    thickness_mm: f64,
) -> Result<(), Invalid> {
    let (low, high) = surrogate.supported(thickness_mm)?;
    if (low - 1e-9..=high + 1e-9).contains(&libm::log(medium.sigma_t_per_mm())) {
        return Ok(());
    }
    let allowed = format!(
        "at {thickness_mm} mm the dictionary predicts {:.4} to {:.4}",
        libm::exp(low),
        libm::exp(high)
    );
    Err(Invalid::new("sigma_t_per_mm", medium.sigma_t_per_mm(), allowed))
}
