//! Writes the table of a measurement as CSV.

use std::borrow::Cow;

use optics_model::fit::{Interval, MaterialFit};

use super::remarks::remarks;

/// The table as CSV: one row per channel.
pub(crate) fn table_csv(fits: &[MaterialFit]) -> anyhow::Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record([
        "material",
        "channel",
        "sigma_t_per_mm",
        "sigma_t_low",
        "sigma_t_high",
        "albedo",
        "albedo_low",
        "albedo_high",
        "g",
        "g_low",
        "g_high",
        "error",
        "resolved",
        "grid_sigma_t_per_mm",
        "grid_albedo",
        "grid_g",
        "grid_error",
        "remarks",
        "reduced_scattering_per_mm",
        "reduced_scattering_low",
        "reduced_scattering_high",
        "absorption_per_mm",
        "absorption_low",
        "absorption_high",
        "misfit",
        "chi2",
        "degrees_of_freedom",
        "probability",
        "resolved_at_g",
        "second_lobe_weight",
        "second_lobe_g",
    ])?;
    for fit in fits {
        for channel in &fit.channels {
            let (Some(r), Some(grid)) = (&channel.refined, channel.candidates.first()) else { continue };
            let low = |i: &Interval| if i.open_low { String::new() } else { i.low.to_string() };
            let high = |i: &Interval| if i.open_high { String::new() } else { i.high.to_string() };
            let (m, n) = (&r.best.medium, &grid.medium);
            let mut row = vec![fit.material.clone(), channel.channel.clone()];
            row.extend([m.sigma_t_per_mm().to_string(), low(&r.sigma_t_per_mm), high(&r.sigma_t_per_mm)]);
            row.extend([m.albedo().to_string(), low(&r.albedo), high(&r.albedo)]);
            row.extend([m.g().to_string(), low(&r.g), high(&r.g)]);
            row.extend([r.best.error.to_string(), r.resolved.to_string()]);
            row.extend([n.sigma_t_per_mm(), n.albedo(), n.g(), grid.error].map(|v| v.to_string()));
            row.push(remarks(channel).join("; "));
            let i = &r.reduced_scattering_per_mm;
            row.extend([m.reduced_scattering_per_mm().to_string(), low(i), high(i)]);
            row.extend([
                m.absorption_per_mm().to_string(),
                low(&r.absorption_per_mm),
                high(&r.absorption_per_mm),
            ]);
            row.push(r.misfit.to_string());
            let l = &r.likelihood;
            row.extend([l.chi2, l.degrees_of_freedom, l.probability].map(|v| v.to_string()));
            row.push(r.resolved_at_g.to_string());
            let lobe = r.second_lobe.map(|lobe| [lobe.weight(), lobe.g()].map(|v| v.to_string()));
            row.extend(lobe.unwrap_or_default());
            writer.write_record(row.iter().map(|cell| as_text(cell).into_owned()))?;
        }
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// A cell that spreadsheets show as text: one that begins like a formula and is no number would be evaluated there,
/// although its content is not trusted.
fn as_text(cell: &str) -> Cow<'_, str> {
    let is_formula = cell.starts_with(['=', '+', '-', '@', '\t', '\r']) && cell.parse::<f64>().is_err();
    if is_formula { format!("'{cell}").into() } else { cell.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Formulas of spreadsheets are quoted as text, and numbers are not.
    #[test]
    fn formulas_are_quoted_and_numbers_are_not() {
        for formula in ["=HYPERLINK(\"http://x\")", "+1+1", "-2+3", "@SUM(A1)", "\t=1"] {
            assert_eq!(as_text(formula), format!("'{formula}"));
        }
        for plain in ["", "white", "-0.5", "+1", "-inf", "1e-3", "a=b"] {
            assert_eq!(as_text(plain), plain);
        }
    }
}
