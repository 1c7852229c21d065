//! The camera of a chart: linear sRGB by a 3 × 3 matrix, CIELAB, and differences of colours.

use libm::{atan2, cbrt, cos, exp, hypot, sin, sqrt};
use nalgebra::Matrix3;

/// Rows sum to 1, so that grey stays grey.
pub type Matrix = [[f64; 3]; 3];

/// How a camera's channels follow from those of the media.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ChartCamera {
    /// By a matrix that is estimated.
    Free,
    /// By this one.
    Held(Matrix),
}

/// Standard deviation of an element of the matrix off its diagonal, before a chart.
pub(crate) const MATRIX_SPREAD: f64 = 0.2;

const XYZ_OF_RGB: Matrix = [
    [0.412_390_8, 0.357_584_3, 0.180_480_8],
    [0.212_639_0, 0.715_168_7, 0.072_192_3],
    [0.019_330_8, 0.119_194_8, 0.950_532_2],
];

/// L*, a* and b* under D65 of linear sRGB, whose white is (1, 1, 1).
pub fn lab(rgb: [f64; 3]) -> [f64; 3] {
    let f = |row: &[f64; 3]| {
        let white: f64 = row.iter().sum();
        let t = row.iter().zip(rgb).map(|(m, v)| m * v).sum::<f64>() / white;
        if t > 216.0 / 24389.0 { cbrt(t) } else { (24389.0 / 27.0 * t + 16.0) / 116.0 }
    };
    let [x, y, z] = [0, 1, 2].map(|i| f(&XYZ_OF_RGB[i]));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Linear sRGB of L*, a* and b* under D65.
pub fn linear_srgb(lab: [f64; 3]) -> [f64; 3] {
    let y = (lab[0] + 16.0) / 116.0;
    let whites = XYZ_OF_RGB.map(|row| row.iter().sum::<f64>());
    let cube = |f: f64| if f > 6.0 / 29.0 { f * f * f } else { (116.0 * f - 16.0) * 27.0 / 24389.0 };
    let xyz = [y + lab[1] / 500.0, y, y - lab[2] / 200.0].map(cube);
    let xyz = nalgebra::Vector3::from_fn(|i, _| xyz[i] * whites[i]);
    let from_rgb = Matrix3::from_fn(|i, j| XYZ_OF_RGB[i][j]);
    from_rgb.try_inverse().map_or([0.0; 3], |inverse| (inverse * xyz).into())
}

/// The difference b − a of two colours in lightness, chroma and hue, each over its weight in CIEDE2000.
/// The third also takes the rotation of blue colours, so that the norm is ΔE₀₀ of small differences with the weights of a.
pub fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    let weights = ColourWeights::at(a, b, [1.0, 0.0]);
    weights.difference(a, b)
}

/// CIEDE2000 of two colours (Sharma, Wu and Dalal 2005).
pub fn delta_e_2000(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [l, c, h] = ColourWeights::at(a, b, [0.5; 2]).difference(a, b);
    sqrt(l * l + c * c + h * h)
}

/// The weights of CIEDE2000.
struct ColourWeights {
    /// Factor of a*.
    stretch: f64,
    semi_axes: [f64; 3],
    rotation: f64,
}

impl ColourWeights {
    /// The weights at a mean of two colours.
    fn at(a: [f64; 3], b: [f64; 3], shares: [f64; 2]) -> Self {
        let mean = |f: &dyn Fn([f64; 3]) -> f64| shares[0] * f(a) + shares[1] * f(b);
        let seventh = |c: f64| sqrt(c.powi(7) / (c.powi(7) + 25_f64.powi(7)));
        let stretch = 1.0 + 0.5 * (1.0 - seventh(mean(&|lab| hypot(lab[1], lab[2]))));
        let chroma = |lab: [f64; 3]| hypot(stretch * lab[1], lab[2]);
        let hue = |lab: [f64; 3]| atan2(lab[2], stretch * lab[1]).rem_euclid(std::f64::consts::TAU);
        let (l, c) = (mean(&|lab| lab[0]), mean(&chroma));
        let h = match (chroma(a) * chroma(b) == 0.0, hue(b) - hue(a)) {
            (true, _) => hue(a) + hue(b),
            (_, by) if by.abs() <= std::f64::consts::PI => mean(&hue),
            (_, by) => hue(a) + shares[1] * (by - std::f64::consts::TAU * by.signum()),
        };
        let degrees = |h: f64| h.to_radians();
        let t =
            1.0 - 0.17 * cos(h - degrees(30.0)) + 0.24 * cos(2.0 * h) + 0.32 * cos(3.0 * h + degrees(6.0))
                - 0.2 * cos(4.0 * h - degrees(63.0));
        let from_50 = (l - 50.0).powi(2);
        let semi_axes = [1.0 + 0.015 * from_50 / sqrt(20.0 + from_50), 1.0 + 0.045 * c, 1.0 + 0.015 * c * t];
        let from_275 = (h.rem_euclid(std::f64::consts::TAU).to_degrees() - 275.0) / 25.0;
        let rotation = -2.0 * seventh(c) * sin(degrees(60.0 * exp(-from_275 * from_275)));
        Self { stretch, semi_axes, rotation }
    }

    /// ΔL/S_L, ΔC/S_C + R ΔH/(2 S_H), and ΔH √(1 − R²/4)/S_H: the sum of their squares is that of CIEDE2000.
    fn difference(&self, a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
        let [c, d] = [a, b].map(|lab| hypot(self.stretch * lab[1], lab[2]));
        let cross = self.stretch * (a[1] * b[2] - b[1] * a[2]);
        let dot = self.stretch * self.stretch * a[1] * b[1] + a[2] * b[2];
        // 2 √(C₁ C₂) sin(Δh/2), which is smooth where a colour is grey.
        let hue = if cross == 0.0 { 0.0 } else { cross.signum() } * sqrt((2.0 * (c * d - dot)).max(0.0));
        let [l, c, h] =
            [(b[0] - a[0]) / self.semi_axes[0], (d - c) / self.semi_axes[1], hue / self.semi_axes[2]];
        [l, c + 0.5 * self.rotation * h, h * sqrt(1.0 - 0.25 * self.rotation * self.rotation)]
    }
}

/// The matrix with these elements off its diagonal, row by row.
pub(crate) fn matrix(others: &[f64]) -> Matrix {
    let mut rest = others.iter();
    let mut matrix = [[0.0; 3]; 3];
    for (i, row) in matrix.iter_mut().enumerate() {
        for (j, element) in row.iter_mut().enumerate().filter(|(j, _)| *j != i) {
            let _ = j;
            *element = *rest.next().expect("six numbers");
        }
        row[i] = 1.0 - row.iter().sum::<f64>();
    }
    matrix
}

pub(crate) fn product(matrix: &Matrix, v: &[f64]) -> [f64; 3] {
    std::array::from_fn(|i| matrix[i].iter().zip(v).map(|(m, v)| m * v).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs 1, 7, 17, 20 and 25 of Sharma, Wu and Dalal 2005, and both ways around the hue's end.
    #[test]
    fn differences_are_those_of_the_publication() {
        for (a, b, expected) in [
            ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
            ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
            ([50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492),
            ([50.0, 2.5, 0.0], [50.0, 3.2592, 0.335], 1.0),
            ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
        ] {
            for (a, b) in [(a, b), (b, a)] {
                assert!((delta_e_2000(a, b) - expected).abs() < 5e-5, "{a:?} {b:?}: {}", delta_e_2000(a, b));
            }
        }
    }

    /// Lab of sRGB's red is 53.24, 80.09, 67.20; colours return from Lab, also beyond the gamut.
    #[test]
    fn colours_return_from_lab() {
        let red = lab([1.0, 0.0, 0.0]);
        assert!(red.iter().zip([53.24, 80.09, 67.20]).all(|(a, b)| (a - b).abs() < 0.02), "{red:?}");
        for rgb in [[0.2, 0.3, 0.9], [0.001, 0.0, 0.002], [1.0, 1.0, 1.0], [-0.01, 0.2, 0.3]] {
            let back = linear_srgb(lab(rgb));
            assert!(back.iter().zip(rgb).all(|(a, b)| (a - b).abs() < 1e-9), "{back:?} {rgb:?}");
        }
    }

    /// Small differences have the norm of CIEDE2000, and change sign with the direction.
    #[test]
    fn small_differences_are_those_of_ciede2000() {
        for a in [[40.0, 10.0, -50.0], [80.0, -3.0, 30.0], [20.0, 0.5, 0.5]] {
            let b = [a[0] + 1e-4, a[1] - 2e-4, a[2] + 1e-4];
            let norm = sqrt(difference(a, b).iter().map(|v| v * v).sum());
            assert!((norm / delta_e_2000(a, b) - 1.0).abs() < 2e-3, "{a:?}: {norm}");
            let back = difference(a, std::array::from_fn(|i| 2.0 * a[i] - b[i]));
            assert!(difference(a, b).iter().zip(back).all(|(f, g)| (f + g).abs() < 1e-3 * norm), "{back:?}");
        }
    }
}
