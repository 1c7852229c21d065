//! A phase function that is tabulated by the scattering angle, and linear in its cosine between the angles.

use std::f64::consts::PI;

use super::MOST_G;
use crate::angle::sin2;
use crate::invalid::{Invalid, Result, check};

/// Most angles of a table.
const MOST_ANGLES: usize = 10_000;

/// A tabulated phase function.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseTable {
    /// As given.
    angle_deg: Vec<f64>,
    value: Vec<f64>,
    /// Rising from −1 to 1.
    cosines: Vec<f64>,
    /// Density at the cosines as a multiple of isotropic scattering's.
    over_isotropic: Vec<f64>,
    mean_cosine: f64,
    peak_width: f64,
}

impl PhaseTable {
    /// Values at angles in degrees that rise from 0 to 180. The values may have any unit: they are normalised, so that
    /// the integral over the sphere is 1.
    pub fn new(angle_deg: Vec<f64>, value: Vec<f64>) -> Result<Self> {
        let (n, of_value) = (angle_deg.len(), value.len());
        if !(2..=MOST_ANGLES).contains(&n) || n != of_value {
            let given = format!("{n} angles and {of_value} values");
            return Err(Invalid::new(
                "phase_function",
                given,
                "2 to 10000 angles with a value each are needed",
            ));
        }
        for (i, angle) in angle_deg.iter().enumerate() {
            let ends = (i > 0 || *angle == 0.0) && (i + 1 < n || *angle == 180.0);
            if !(0.0..=180.0).contains(angle) || !ends || (i > 0 && *angle <= angle_deg[i - 1]) {
                let field = format!("phase_function.angle_deg[{i}]");
                return Err(Invalid::new(field, angle, "angles must rise from 0 to 180 degrees"));
            }
        }
        if let Some(i) = value.iter().position(|v| !(v.is_finite() && *v >= 0.0)) {
            let field = format!("phase_function.value[{i}]");
            return Err(Invalid::new(field, value[i], "allowed are finite numbers from 0 on"));
        }
        // cos θ = 1 − 2 sin²(θ/2): the same bits on every machine.
        let cosines: Vec<f64> = angle_deg.iter().rev().map(|angle| 1.0 - 2.0 * sin2(0.5 * angle)).collect();
        if let Some(i) = cosines.windows(2).position(|pair| pair[0] >= pair[1]) {
            let (field, given) = (format!("phase_function.angle_deg[{}]", n - 2 - i), angle_deg[n - 2 - i]);
            return Err(Invalid::new(field, given, "too near to the next: both have the same cosine"));
        }
        let raw: Vec<f64> = value.iter().rev().copied().collect();
        let integral = integral(&cosines, &raw, |_| 1.0);
        // A product, so that values too small or too large for a mean are refused, too.
        if !(1e-200..1e200).contains(&integral) {
            return Err(Invalid::new(
                "phase_function.value",
                "values without an integral",
                "some must be above 0",
            ));
        }
        let over_isotropic: Vec<f64> = raw.iter().map(|v| 2.0 * v / integral).collect();
        let mean_cosine = 0.5 * self::integral(&cosines, &over_isotropic, |c| c);
        let allowed = "allowed are mean cosines from -0.999 to 0.999";
        check("phase_function.mean_cosine", mean_cosine, |g| g.abs() <= MOST_G, allowed)?;
        let peak_width = peak_width(&angle_deg, &value, 0.5 * integral);
        Ok(Self { angle_deg, value, cosines, over_isotropic, mean_cosine, peak_width })
    }

    pub fn angle_deg(&self) -> &[f64] {
        &self.angle_deg
    }

    /// The values as they were given.
    pub fn value(&self) -> &[f64] {
        &self.value
    }

    pub fn mean_cosine(&self) -> f64 {
        self.mean_cosine
    }

    pub(super) fn peak_width(&self) -> f64 {
        self.peak_width
    }

    pub(super) fn over_isotropic(&self, cosine: f64) -> f64 {
        let cosine = cosine.clamp(-1.0, 1.0);
        let after = self.cosines.partition_point(|c| *c <= cosine).clamp(1, self.cosines.len() - 1);
        let [c0, c1] = [self.cosines[after - 1], self.cosines[after]];
        let [v0, v1] = [self.over_isotropic[after - 1], self.over_isotropic[after]];
        (v0 + (v1 - v0) * (cosine - c0) / (c1 - c0)).max(0.0)
    }

    /// The mean of the density over cosines `along + across cos φ`, in 1/sr: the trapezoidal rule over φ.
    pub(super) fn azimuthal_mean(&self, along: f64, across: f64) -> f64 {
        let steps = ((16.0 / self.peak_width) as usize).clamp(64, 4096);
        // cos φ by rotation: few steps, and the same bits on every machine.
        let turn = sin2(90.0 / steps as f64);
        let (cos, sin) = (1.0 - 2.0 * turn, 2.0 * (turn * (1.0 - turn)).sqrt());
        let (mut c, mut s) = (1.0, 0.0);
        let mut sum = 0.5 * (self.over_isotropic(along + across) + self.over_isotropic(along - across));
        for _ in 1..steps {
            (c, s) = (c * cos - s * sin, s * cos + c * sin);
            sum += self.over_isotropic(along + across * c);
        }
        sum / (4.0 * PI * steps as f64)
    }

    /// Cosines at `count` equal steps of the distribution function, in the middle of each: the inverse of a function that
    /// is quadratic between the table's cosines.
    pub fn cosines_at_quantiles(&self, count: usize) -> Vec<f32> {
        let (mut segment, mut below) = (0, 0.0);
        let mass = |i: usize| {
            0.25 * (self.over_isotropic[i] + self.over_isotropic[i + 1])
                * (self.cosines[i + 1] - self.cosines[i])
        };
        let mut quantile = |k: usize| {
            let wanted = (k as f64 + 0.5) / count as f64;
            while segment + 2 < self.cosines.len() && below + mass(segment) < wanted {
                below += mass(segment);
                segment += 1;
            }
            let (c0, width) = (self.cosines[segment], self.cosines[segment + 1] - self.cosines[segment]);
            let [v0, v1] = [self.over_isotropic[segment], self.over_isotropic[segment + 1]];
            // ½ v₀ x + ¼ (v₁ − v₀) x²/width = rest, for x from 0 to the width; the root without cancellation.
            let rest = (wanted - below).max(0.0);
            let slope = (v1 - v0) / width;
            let x = 4.0 * rest / (v0 + (v0 * v0 + 4.0 * slope * rest).max(0.0).sqrt());
            (c0 + if x.is_finite() { x.min(width) } else { 0.0 }) as f32
        };
        (0..count).map(&mut quantile).collect()
    }
}

/// ∫ f(c) w(c) dc, f being linear between the cosines and w a polynomial of at most the first degree: Simpson's rule.
fn integral(cosines: &[f64], values: &[f64], weight: impl Fn(f64) -> f64) -> f64 {
    let pairs = cosines.windows(2).zip(values.windows(2));
    let area = |(c, v): (&[f64], &[f64])| {
        let (middle, mean) = (0.5 * (c[0] + c[1]), 0.5 * (v[0] + v[1]));
        (c[1] - c[0]) / 6.0 * (v[0] * weight(c[0]) + 4.0 * mean * weight(middle) + v[1] * weight(c[1]))
    };
    pairs.map(area).sum()
}

/// Least angle in radians over which a peak falls to a third, on either side of it. Peaks below the value of isotropic
/// scattering do not count.
fn peak_width(angle_deg: &[f64], value: &[f64], isotropic: f64) -> f64 {
    let [back_angle, back_value] =
        [angle_deg, value].map(|given| given.iter().rev().copied().collect::<Vec<_>>());
    let sides = [(angle_deg, value), (&back_angle[..], &back_value[..])];
    let widths = sides.into_iter().flat_map(|(angle, value)| {
        let peaks = thirds(value).into_iter().enumerate().filter(move |(i, _)| value[*i] > isotropic);
        peaks.filter_map(move |(i, low)| Some((angle[low?] - angle[i]).abs()))
    });
    widths.fold(180.0, f64::min).to_radians().min(1.0)
}

/// For each value the nearest of the earlier ones that is below a third of it.
fn thirds(value: &[f64]) -> Vec<Option<usize>> {
    // Indices of the values that are below all later ones: these rise.
    let mut lows: Vec<usize> = Vec::new();
    let nearest = |i: usize| {
        let below = lows.partition_point(|low| value[*low] < value[i] / 3.0);
        let nearest = below.checked_sub(1).map(|last| lows[last]);
        while lows.pop_if(|low| value[*low] >= value[i]).is_some() {}
        lows.push(i);
        nearest
    };
    (0..value.len()).map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phase::PhaseFunction;

    /// The nearest low value before each is the one that a search through all earlier ones finds, and the largest table is
    /// made at once whatever its shape.
    #[test]
    fn largest_table_is_made_at_once() {
        let ragged: Vec<f64> = (0..300_u64).map(|i| (i * i * 7919 % 1009) as f64).collect();
        let low = |i: usize| (0..i).rfind(|j| ragged[*j] < ragged[i] / 3.0);
        assert_eq!(thirds(&ragged), (0..ragged.len()).map(low).collect::<Vec<_>>());
        let angles: Vec<f64> =
            (0..MOST_ANGLES).map(|i| 180.0 * i as f64 / (MOST_ANGLES - 1) as f64).collect();
        let values: Vec<f64> = (0..MOST_ANGLES).map(|i| 1.0 + 0.1 * (i % 2) as f64).collect();
        // Searches through all values would take a hundred times as long as this test may.
        for _ in 0..1000 {
            PhaseTable::new(angles.clone(), values.clone()).unwrap();
        }
    }

    /// Henyey–Greenstein in steps of half a degree.
    fn tabulated(g: f64) -> PhaseTable {
        let hg = PhaseFunction::henyey_greenstein(g).unwrap();
        let angle_deg: Vec<f64> = (0..=360).map(|i| 0.5 * f64::from(i)).collect();
        let value = angle_deg.iter().map(|a| 7.0 * hg.density(libm::cos(a.to_radians()))).collect();
        PhaseTable::new(angle_deg, value).unwrap()
    }

    /// A tabulated Henyey–Greenstein function has the mean cosine and the azimuthal means of the exact one.
    #[test]
    fn tabulated_lobe_agrees_with_the_exact_one() {
        for g in [-0.3, 0.0, 0.4, 0.7] {
            let (table, hg) = (tabulated(g), PhaseFunction::henyey_greenstein(g).unwrap());
            assert!((table.mean_cosine() - g).abs() < 1e-4, "{g}: {}", table.mean_cosine());
            for (u, mu) in [(1.0, 0.9), (-0.4, 0.8), (0.2, 0.7), (0.9, 0.88_f64)] {
                let across = ((1.0 - u * u) * (1.0 - mu * mu)).sqrt();
                let (found, exact) = (table.azimuthal_mean(u * mu, across), hg.azimuthal_mean(u, mu));
                assert!((found / exact - 1.0).abs() < 3e-4, "{g} {u} {mu}: {found} {exact}");
            }
        }
    }

    /// The mean over quantiles is the mean cosine, to the error of the midpoint rule where the density vanishes; the
    /// distribution function at a quantile is the quantile's.
    #[test]
    fn quantiles_invert_the_distribution() {
        let angles = vec![0.0, 10.0, 40.0, 100.0, 150.0, 180.0];
        for values in [vec![1.0; 6], vec![9.0, 3.0, 1.0, 0.0, 0.0, 2.0], vec![0.0, 0.0, 1.0, 0.0, 0.5, 0.0]] {
            let table = PhaseTable::new(angles.clone(), values).unwrap();
            let quantiles = table.cosines_at_quantiles(1 << 16);
            let mean = quantiles.iter().map(|c| f64::from(*c)).sum::<f64>() / quantiles.len() as f64;
            assert!((mean - table.mean_cosine()).abs() < 3e-6, "{mean} {}", table.mean_cosine());
            for (k, cosine) in quantiles.iter().enumerate().step_by(997) {
                let n = 20_000;
                let step = (f64::from(*cosine) + 1.0) / f64::from(n);
                let at = |i: i32| table.over_isotropic(-1.0 + (f64::from(i) + 0.5) * step);
                let below = 0.5 * (0..n).map(at).sum::<f64>() * step;
                assert!((below - (k as f64 + 0.5) / 65_536.0).abs() < 1e-4, "{k}: {below}");
            }
        }
    }

    /// The narrowest peak counts, wherever it is.
    #[test]
    fn width_is_that_of_the_narrowest_peak() {
        let width = |angles: &[f64], values: &[f64]| {
            PhaseTable::new(angles.to_vec(), values.to_vec()).unwrap().peak_width().to_degrees()
        };
        assert!((width(&[0.0, 5.0, 90.0, 180.0], &[9.0, 1.0, 1.0, 1.0]) - 5.0).abs() < 1e-9);
        assert!((width(&[0.0, 60.0, 62.0, 65.0, 180.0], &[1.0, 1.0, 9.0, 1.0, 1.0]) - 2.0).abs() < 1e-9);
        assert!(width(&[0.0, 180.0], &[1.0, 1.0]) > 57.0);
    }

    /// Refusals name the angle or the value.
    #[test]
    fn wrong_tables_are_refused() {
        let refused =
            |angle: &[f64], value: &[f64]| PhaseTable::new(angle.to_vec(), value.to_vec()).unwrap_err();
        for (angle, value, field) in [
            (&[0.0][..], &[1.0][..], "phase_function"),
            (&[0.0, 180.0], &[1.0], "phase_function"),
            (&[1.0, 180.0], &[1.0, 1.0], "phase_function.angle_deg[0]"),
            (&[0.0, 90.0, 80.0, 180.0], &[1.0; 4], "phase_function.angle_deg[2]"),
            (&[0.0, 170.0], &[1.0, 1.0], "phase_function.angle_deg[1]"),
            (&[0.0, 180.0], &[1.0, -1.0], "phase_function.value[1]"),
            (&[0.0, 180.0], &[0.0, 0.0], "phase_function.value"),
            (&[0.0, 1e-8, 180.0], &[1.0; 3], "phase_function.angle_deg[0]"),
            (&[0.0, 0.1, 0.2, 180.0], &[1e9, 0.0, 0.0, 0.0], "phase_function.mean_cosine"),
        ] {
            assert_eq!(refused(angle, value).field(), field);
        }
    }
}
