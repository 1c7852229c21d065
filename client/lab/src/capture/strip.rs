//! Extracts a strip across the edge from a photograph, which Fig. 2 shows next to the simulation.

use optics_capture::{Board, Colour, EdgeProfile, Frame, Pattern};

use super::picture::{data_uri, srgb};

/// Rows of a strip along the edge; across, it has the profile's bins.
const ROWS: usize = 72;

/// Pitch of the rows in mm, that of the profiles' bins.
const PITCH_MM: f64 = 10.0 / 360.0;

/// Raw numbers of the sensor at the positions of a strip, row by row.
#[derive(Debug, Clone)]
pub struct Strip {
    numbers: Vec<[f32; 3]>,
    x_mm: Vec<f64>,
}

impl Strip {
    /// Samples a frame; `x_mm` are the positions across the edge.
    pub fn of(frame: &Frame, board: &Board, x_mm: &[f64]) -> Self {
        let rows = 0..ROWS;
        let y_mm = |row: usize| (row as f64 + 0.5 - 0.5 * ROWS as f64) * PITCH_MM;
        let numbers = rows.flat_map(|row| x_mm.iter().map(move |x| (*x, y_mm(row))));
        let numbers = numbers.map(|(x, y)| nearest(frame, board.to_px(x, y)));
        Self { numbers: numbers.collect(), x_mm: x_mm.to_vec() }
    }

    /// A picture of radiance factors, calibrated by `profiles`.
    pub fn data_uri(&self, profiles: &[EdgeProfile]) -> String {
        let width = self.x_mm.len();
        let lines = [0, 1, 2].map(|c| self.line_to(c, &profiles[c]));
        let value = |v: &[f32; 3], c: usize| lines[c].0 + lines[c].1 * f64::from(v[c]);
        let bytes = self.numbers.iter().flat_map(|v| std::array::from_fn::<u8, 3, _>(|c| srgb(value(v, c))));
        data_uri(width, ROWS, &bytes.collect::<Vec<u8>>())
    }

    /// Intercept and slope of the line from raw numbers to radiance factors, by least squares over the columns.
    fn line_to(&self, c: usize, profile: &EdgeProfile) -> (f64, f64) {
        let width = self.x_mm.len();
        let column = |i: usize| {
            let numbers = self.numbers.iter().skip(i).step_by(width).map(|v| f64::from(v[c]));
            numbers.sum::<f64>() / ROWS as f64
        };
        let pairs: Vec<(f64, f64)> =
            profile.values.iter().take(width).enumerate().map(|(i, v)| (column(i), *v)).collect();
        let n = pairs.len().max(1) as f64;
        let (mean_x, mean_y) =
            (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n);
        let (mut xx, mut xy) = (0.0, 0.0);
        for (x, y) in &pairs {
            xx += (x - mean_x).powi(2);
            xy += (x - mean_x) * (y - mean_y);
        }
        let slope = if xx > 0.0 { xy / xx } else { 0.0 };
        (mean_y - slope * mean_x, slope)
    }
}

/// A picture of simulated profiles, which are constant along the edge.
pub(super) fn simulated_uri(values: &[Vec<f64>; 3]) -> String {
    let width = values[0].len();
    let row: Vec<u8> =
        (0..width).flat_map(|i| [0, 1, 2].map(|c| srgb(values[c].get(i).copied().unwrap_or(0.0)))).collect();
    data_uri(width, ROWS, &row.repeat(ROWS))
}

/// The samples of each colour that are nearest to a position.
fn nearest(frame: &Frame, [x, y]: [f64; 2]) -> [f32; 3] {
    let clamped = |v: f64, most: usize| (v.floor().max(0.0) as usize).min(most - 1);
    let (x, y) = (clamped(x, frame.width()), clamped(y, frame.height()));
    match frame.pattern() {
        Pattern::Rgb => std::array::from_fn(|c| f32::from(frame.samples()[3 * (y * frame.width() + x) + c])),
        Pattern::One(_) => [f32::from(frame.samples()[y * frame.width() + x]); 3],
        Pattern::Bayer(colours) => Colour::ALL.map(|colour| {
            // The cell of the mosaic that contains the position.
            let (left, top) = ((x & !1).min(frame.width() - 2), (y & !1).min(frame.height() - 2));
            let at = |i: usize| frame.samples()[(top + i / 2) * frame.width() + left + i % 2];
            let (mut sum, mut count) = (0.0, 0.0);
            for i in (0..4).filter(|i| colours[*i] == colour) {
                sum += f32::from(at(i));
                count += 1.0;
            }
            sum / count
        }),
    }
}
