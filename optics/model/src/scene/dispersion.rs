//! The refractive index of a material over wavelength: Cauchy's or Sellmeier's formula, or a table. A scene uses the
//! difference from the index at the sodium D line, at which indices are usually measured.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::invalid::{Invalid, Result};
use crate::medium::check_ior;

/// Wavelength in nm at which a scene and a grid have their indices: the mean of the sodium D lines.
pub const D_LINE_NM: f64 = 589.3;

/// Most terms of Sellmeier's formula, and most rows of a table.
const MOST: usize = 1000;

/// Coefficients of one formula, or a table, as in a scene file.
///
/// With λ in µm: Cauchy has n = n_D + B (1/λ² − 1/λ_D²) + C (1/λ⁴ − 1/λ_D⁴), Sellmeier n² = 1 + Σ Bᵢ λ²/(λ² − Cᵢ). A table
/// is linear between its rows.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DispersionCurve {
    #[serde(skip_serializing_if = "is_zero")]
    pub cauchy_b_um2: f64,
    #[serde(skip_serializing_if = "is_zero")]
    pub cauchy_c_um4: f64,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sellmeier_b: Vec<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sellmeier_c_um2: Vec<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub wavelength_nm: Vec<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ior: Vec<f64>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// A curve that has an index at the D line.
#[derive(Debug, Clone, PartialEq)]
pub struct Dispersion {
    curve: DispersionCurve,
    at_d_line: f64,
}

impl Dispersion {
    pub fn new(curve: DispersionCurve) -> Result<Self> {
        curve.check()?;
        let at_d_line = curve.at(D_LINE_NM).map_err(|e| {
            let allowed = format!("the index at {D_LINE_NM} nm is needed: {}", e.allowed());
            Invalid::new(e.field(), e.given(), allowed)
        })?;
        Ok(Self { curve, at_d_line })
    }

    pub fn curve(&self) -> &DispersionCurve {
        &self.curve
    }

    /// n(λ) − n_D.
    pub fn difference(&self, wavelength_nm: f64) -> Result<f64> {
        Ok(self.curve.at(wavelength_nm)? - self.at_d_line)
    }
}

impl fmt::Display for Dispersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let curve = &self.curve;
        match curve.kind() {
            Ok(CurveKind::Cauchy) if curve.cauchy_c_um4 == 0.0 => {
                write!(f, "Cauchy B = {} µm²", curve.cauchy_b_um2)
            }
            Ok(CurveKind::Cauchy) => {
                write!(f, "Cauchy B = {} µm², C = {} µm⁴", curve.cauchy_b_um2, curve.cauchy_c_um4)
            }
            Ok(CurveKind::Sellmeier) => {
                write!(f, "Sellmeier B = {:?}, C = {:?} µm²", curve.sellmeier_b, curve.sellmeier_c_um2)
            }
            _ => write!(f, "{:?} at {:?} nm", curve.ior, curve.wavelength_nm),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum CurveKind {
    Cauchy,
    Sellmeier,
    Table,
}

impl DispersionCurve {
    fn kind(&self) -> Result<CurveKind> {
        let given = [
            (self.cauchy_b_um2 != 0.0 || self.cauchy_c_um4 != 0.0, CurveKind::Cauchy),
            (!self.sellmeier_b.is_empty() || !self.sellmeier_c_um2.is_empty(), CurveKind::Sellmeier),
            (!self.wavelength_nm.is_empty() || !self.ior.is_empty(), CurveKind::Table),
        ];
        let mut kinds = given.iter().filter(|(is_given, _)| *is_given).map(|(_, kind)| *kind);
        match (kinds.next(), kinds.next()) {
            (Some(kind), None) => Ok(kind),
            (first, _) => {
                let allowed = "give cauchy_b_um2 (and cauchy_c_um4), or sellmeier_b with sellmeier_c_um2, or \
                               wavelength_nm with ior";
                let given = if first.is_some() { "several formulas" } else { "no formula" };
                Err(Invalid::new("dispersion", given, allowed))
            }
        }
    }

    fn check(&self) -> Result<()> {
        let finite = |field: &str, values: &[f64]| match values.iter().find(|v| !v.is_finite()) {
            Some(value) => Err(Invalid::new(field, value, "finite numbers are needed")),
            None => Ok(()),
        };
        let pairs = |[a, b]: [&str; 2], of: [&[f64]; 2], least: usize| {
            finite(a, of[0])?;
            finite(b, of[1])?;
            if of[0].len() == of[1].len() && (least..=MOST).contains(&of[0].len()) {
                return Ok(());
            }
            let allowed = format!("{a} and {b} need as many numbers each, {least} to {MOST}");
            Err(Invalid::new(a, format!("{} and {} numbers", of[0].len(), of[1].len()), allowed))
        };
        match self.kind()? {
            CurveKind::Cauchy => {
                finite("cauchy_b_um2", &[self.cauchy_b_um2]).and(finite("cauchy_c_um4", &[self.cauchy_c_um4]))
            }
            CurveKind::Sellmeier => {
                pairs(["sellmeier_b", "sellmeier_c_um2"], [&self.sellmeier_b, &self.sellmeier_c_um2], 1)
            }
            CurveKind::Table => {
                pairs(["wavelength_nm", "ior"], [&self.wavelength_nm, &self.ior], 2)?;
                if let Some(i) = (1..self.wavelength_nm.len())
                    .find(|i| self.wavelength_nm[*i] <= self.wavelength_nm[i - 1])
                {
                    let field = format!("wavelength_nm[{i}]");
                    return Err(Invalid::new(
                        field,
                        self.wavelength_nm[i],
                        "wavelengths must be strictly rising",
                    ));
                }
                self.ior.iter().try_for_each(|n| check_ior("ior", *n).map(|_| ()))
            }
        }
    }

    /// The index at a wavelength; Cauchy's without the constant.
    fn at(&self, wavelength_nm: f64) -> Result<f64> {
        let square_um2 = (1e-3 * wavelength_nm).powi(2);
        match self.kind()? {
            CurveKind::Cauchy => Ok(self.cauchy_b_um2 / square_um2 + self.cauchy_c_um4 / square_um2.powi(2)),
            CurveKind::Sellmeier => {
                let terms = self.sellmeier_b.iter().zip(&self.sellmeier_c_um2);
                let square = 1.0 + terms.map(|(b, c)| b * square_um2 / (square_um2 - c)).sum::<f64>();
                if square.is_finite() && square >= 1.0 {
                    return Ok(square.sqrt());
                }
                let given = format!("n² = {square} at {wavelength_nm} nm");
                Err(Invalid::new("sellmeier_b", given, "indices of at least 1 are needed"))
            }
            CurveKind::Table => self.in_table(wavelength_nm).ok_or_else(|| {
                let [first, last] = [self.wavelength_nm[0], self.wavelength_nm[self.wavelength_nm.len() - 1]];
                let given = format!("{first} to {last} nm");
                Invalid::new("wavelength_nm", given, format!("the table must contain {wavelength_nm} nm"))
            }),
        }
    }

    fn in_table(&self, nm: f64) -> Option<f64> {
        let rows = &self.wavelength_nm;
        let next = rows.partition_point(|row| *row < nm);
        let row = *rows.get(next)?;
        if row == nm {
            return Some(self.ior[next]);
        }
        let before = next.checked_sub(1)?;
        let share = (nm - rows[before]) / (row - rows[before]);
        Some(self.ior[before] + share * (self.ior[next] - self.ior[before]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Schott's coefficients of N-BK7, whose catalogue has the indices 1.52238 (F), 1.51680 (d), 1.51432 (C).
    fn glass() -> DispersionCurve {
        DispersionCurve {
            sellmeier_b: vec![1.039_612_12, 0.231_792_344, 1.010_469_45],
            sellmeier_c_um2: vec![0.006_000_698_67, 0.020_017_914_4, 103.560_653],
            ..DispersionCurve::default()
        }
    }

    #[test]
    fn sellmeier_gives_catalogue_indices() {
        let (curve, glass) = (glass(), Dispersion::new(glass()).unwrap());
        for (nm, index) in [(486.13, 1.522_38), (587.56, 1.516_80), (656.27, 1.514_32)] {
            assert!((curve.at(nm).unwrap() - index).abs() < 6e-6, "{nm}: {:?}", curve.at(nm));
            let difference = glass.difference(nm).unwrap();
            assert!((difference - (index - 1.516_727)).abs() < 1e-5, "{nm}: {difference}");
        }
        assert_eq!(glass.difference(D_LINE_NM).unwrap(), 0.0);
    }

    /// Cauchy's formula by hand, and a table of its indices.
    #[test]
    fn tables_and_formulas_agree() {
        let cauchy =
            DispersionCurve { cauchy_b_um2: 0.004, cauchy_c_um4: 1e-4, ..DispersionCurve::default() };
        let by_hand = |um: f64| 0.004 / (um * um) + 1e-4 / um.powi(4);
        let formula = Dispersion::new(cauchy).unwrap();
        let rows: Vec<f64> = (0..=400).map(f64::from).map(|i| 400.0 + i).collect();
        let ior = rows.iter().map(|nm| 1.5 + by_hand(1e-3 * nm)).collect();
        let table = DispersionCurve { wavelength_nm: rows, ior, ..DispersionCurve::default() };
        let table = Dispersion::new(table).unwrap();
        for nm in [400.0, 436.5, 589.3, 700.0, 800.0] {
            let expected = by_hand(1e-3 * nm) - by_hand(0.5893);
            assert!((formula.difference(nm).unwrap() - expected).abs() < 1e-15);
            assert!((table.difference(nm).unwrap() - expected).abs() < 1e-6, "{nm}");
        }
        let message = table.difference(399.0).unwrap_err().to_string();
        assert_eq!(message, "wavelength_nm = 400 to 800 nm is not valid: the table must contain 399 nm");
    }

    #[test]
    fn wrong_curves_are_refused() {
        let none = DispersionCurve::default;
        let table = |wavelength_nm: [f64; 2], ior: [f64; 2]| DispersionCurve {
            wavelength_nm: wavelength_nm.to_vec(),
            ior: ior.to_vec(),
            ..none()
        };
        let (two, other, one) = (
            DispersionCurve { cauchy_b_um2: 0.004, ..glass() },
            DispersionCurve { sellmeier_c_um2: vec![1.0], ..glass() },
            DispersionCurve { sellmeier_b: vec![1.0], sellmeier_c_um2: vec![0.4], ..none() },
        );
        for (curve, expected) in [
            (none(), "dispersion = no formula is not valid: give cauchy_b_um2"),
            (two, "dispersion = several formulas is not valid"),
            (DispersionCurve { cauchy_b_um2: f64::NAN, ..none() }, "cauchy_b_um2 = NaN"),
            (other, "sellmeier_b = 3 and 1 numbers is not valid"),
            (one, "sellmeier_b = n² = -5"),
            (
                table([400.0, 500.0], [1.5, 1.4]),
                "wavelength_nm = 400 to 500 nm is not valid: the index at 589.3 nm",
            ),
            (
                table([700.0, 500.0], [1.5, 1.4]),
                "wavelength_nm[1] = 500 is not valid: wavelengths must be strictly",
            ),
            (table([400.0, 700.0], [1.5, 0.4]), "ior = 0.4 is not valid"),
        ] {
            let error = Dispersion::new(curve).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
    }
}
