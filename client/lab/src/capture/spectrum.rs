//! Reads quantities over wavelength from tables: a column of wavelengths, and one for each quantity.

use std::path::Path;

use anyhow::{Context, Result, bail};
use optics_model::Invalid;

use crate::grid_file::read_text;
use crate::number_table::{NumberRow, NumberTable};

/// Negative values of a larger share of the greatest one are errors; smaller ones are noise.
const NOISE: f64 = 0.01;

/// A quantity over wavelength, linear between its rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spectrum {
    /// Wavelength in nm, rising, and value.
    rows: Vec<(f64, f64)>,
}

impl Spectrum {
    /// The quantities of a file, in the order of their columns. Lines beginning with # are comments.
    fn read(path: &Path) -> Result<Vec<Self>> {
        let what = "table of wavelengths";
        Self::parse(&read_text(path, what)?).with_context(|| format!("{what} {}", path.display()))
    }

    /// The quantities of a file whose name stands in a field of a file in `folder`.
    pub fn read_in(folder: &Path, field: &str, file: &str) -> Result<Vec<Self>, Invalid> {
        let read = Self::read(&folder.join(file));
        read.map_err(|e| Invalid::new(field, format!("{file:?}"), format!("{e:#}")))
    }

    /// The only quantity of such a file.
    pub fn only_in(folder: &Path, field: &str, file: &str) -> Result<Self, Invalid> {
        let mut columns = Self::read_in(folder, field, file)?;
        if columns.len() == 1 {
            Ok(columns.swap_remove(0))
        } else {
            let given = format!("{file:?} with {} columns of values", columns.len());
            Err(Invalid::new(field, given, "one column of values is needed"))
        }
    }

    pub fn parse(text: &str) -> Result<Vec<Self>> {
        let needed = "wavelength_nm and at least one column of values";
        let mut table = NumberTable::parse(text, is_wavelength, needed)?;
        // Instruments scan from long wavelengths to short ones.
        let ends = [table.rows.first(), table.rows.last()].map(|row| row.and_then(|row| row.numbers[0]));
        if let [Some(first), Some(last)] = ends
            && first > last
        {
            table.rows.reverse();
        }
        let mut spectra = vec![Self { rows: Vec::new() }; table.names.len() - 1];
        for NumberRow { line, numbers } in &table.rows {
            let nm = numbers[0].with_context(|| format!("line {line}: the wavelength is missing"))?;
            if nm < 100.0 {
                bail!("line {line}: {} = {nm}: wavelengths in nm are needed", table.names[0]);
            }
            if numbers[1..].iter().all(Option::is_none) {
                continue;
            }
            if spectra[0].rows.last().is_some_and(|(before, _)| *before >= nm) {
                bail!("line {line}: {} = {nm}: wavelengths must rise", table.names[0]);
            }
            for (i, spectrum) in spectra.iter_mut().enumerate() {
                let name = &table.names[i + 1];
                let value = numbers[i + 1].with_context(|| format!("line {line}: {name} is missing"))?;
                spectrum.rows.push((nm, if name.contains('%') { 0.01 * value } else { value }));
            }
        }
        if spectra[0].rows.len() < 2 {
            bail!("at least two wavelengths are needed");
        }
        for (spectrum, name) in spectra.iter_mut().zip(&table.names[1..]) {
            let least = -NOISE * spectrum.greatest();
            if let Some((nm, value)) = spectrum.rows.iter().find(|(_, value)| *value < least) {
                bail!("{name} = {value} at {nm} nm is no number from 0");
            }
            spectrum.rows.iter_mut().for_each(|(_, value)| *value = value.max(0.0));
        }
        Ok(spectra)
    }

    pub fn range_nm(&self) -> (f64, f64) {
        (self.rows[0].0, self.rows[self.rows.len() - 1].0)
    }

    pub fn wavelengths_nm(&self) -> impl Iterator<Item = f64> {
        self.rows.iter().map(|(nm, _)| *nm)
    }

    pub fn greatest(&self) -> f64 {
        self.rows.iter().map(|(_, value)| *value).fold(0.0, f64::max)
    }

    /// These values times those of another table.
    pub fn lit(&self, field: &str, light: &Self) -> Result<Self, Invalid> {
        let lit = |(nm, value): &(f64, f64)| {
            Ok((*nm, if *value > 0.0 { value * light.within(field, *nm)? } else { 0.0 }))
        };
        Ok(Self { rows: self.rows.iter().map(lit).collect::<Result<_, Invalid>>()? })
    }

    /// Standard deviation of wavelengths that are weighted by the values; 0 if all values are 0.
    pub fn std_dev(&self) -> f64 {
        self.mean_and_std_dev().map_or(0.0, |(_, std_dev)| std_dev)
    }

    /// Mean and standard deviation of wavelengths that are weighted by the values, by the trapezoidal rule; none if all
    /// values are 0.
    pub fn mean_and_std_dev(&self) -> Option<(f64, f64)> {
        let moment = |of: &dyn Fn(f64) -> f64| -> f64 {
            let pairs = self.rows.windows(2);
            pairs.map(|w| 0.5 * (w[1].0 - w[0].0) * (w[0].1 * of(w[0].0) + w[1].1 * of(w[1].0))).sum()
        };
        let whole = moment(&|_| 1.0);
        if whole <= 0.0 {
            return None;
        }
        let mean = moment(&|nm| nm) / whole;
        Some((mean, (moment(&|nm| (nm - mean).powi(2)) / whole).sqrt()))
    }

    /// The value at a wavelength; 0 outside of the table.
    pub fn at(&self, nm: f64) -> f64 {
        let after = self.rows.partition_point(|(at, _)| *at < nm);
        match (after.checked_sub(1).map(|i| self.rows[i]), self.rows.get(after)) {
            (_, Some((at, value))) if *at == nm => *value,
            (Some((a, from)), Some((b, to))) => from + (to - from) * (nm - a) / (b - a),
            _ => 0.0,
        }
    }

    /// The value at a wavelength, which must lie in the table.
    pub fn within(&self, field: &str, nm: f64) -> Result<f64, Invalid> {
        let (from, to) = self.range_nm();
        if (from..=to).contains(&nm) {
            Ok(self.at(nm))
        } else {
            let nm = (100.0 * nm).round() / 100.0;
            Err(Invalid::new(field, format!("{nm} nm"), format!("the table has {from} to {to} nm")))
        }
    }
}

/// Whether a column is called like wavelengths in nm.
fn is_wavelength(name: &str) -> bool {
    let name = name.to_lowercase();
    ["wavelength", "lambda", "λ", "nm", "wl"].iter().any(|begin| name.starts_with(begin))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Falling wavelengths, per cent, noise below 0 and missing numbers are read as they are meant.
    #[test]
    fn spectra_of_instruments_are_read() {
        let expected = Spectrum::parse("wavelength_nm,a\n400,0\n500,0.5\n600,0.25\n").unwrap();
        for text in [
            "Wavelength (nm),% Transmission\n600,25\n500,50\n450,\n400,-0.02\n",
            "nm;T\n400;-2e-5\n500;0,5\n600;0,25\n",
            "Sample 1,\nWavelength (nm),%T,\n600,25,\n500,50,\n400,0,\n",
        ] {
            assert_eq!(Spectrum::parse(text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn spectra_are_linear_between_rows() {
        let spectra = Spectrum::parse("# a lamp\nwavelength_nm, a, b\n400,1,0\n500,3,1\n").unwrap();
        assert_eq!(
            [399.0, 400.0, 450.0, 500.0, 501.0].map(|nm| spectra[0].at(nm)),
            [0.0, 1.0, 2.0, 3.0, 0.0]
        );
        assert_eq!(spectra[1].within("rho", 425.0), Ok(0.25));
        assert!(spectra[1].within("rho", 501.0).is_err());
        let box_of_10 = Spectrum::parse("wavelength_nm,a\n545,1\n547.5,1\n550,1\n552.5,1\n555,1\n").unwrap();
        let exact = 10.0 / 12.0_f64.sqrt();
        assert!((box_of_10[0].std_dev() / exact - 1.0).abs() < 0.1, "{} {exact}", box_of_10[0].std_dev());
    }

    /// Errors have the line and the cell.
    #[test]
    fn wrong_spectra_are_refused() {
        for (text, message) in [
            (
                "angle,a\n400,1\n",
                "the first line is \"angle,a\": wavelength_nm and at least one column of values are needed",
            ),
            ("wavelength_nm,a\n400,1\n400,1\n", "line 3: wavelength_nm = 400: wavelengths must rise"),
            ("wavelength_nm,a\n400,-1\n500,1\n", "a = -1 at 400 nm is no number from 0"),
            ("wavelength_nm,a\n400,1\n", "at least two wavelengths are needed"),
        ] {
            assert_eq!(Spectrum::parse(text).unwrap_err().to_string(), message);
        }
    }
}
