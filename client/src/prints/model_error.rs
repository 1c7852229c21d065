//! The error that predictions of media from a chart have besides those of media and set-up: cross-validation has found it,
//! for colours of the chart's camera, or for logarithms by channel.

use farm_lab::chart::is_multiple;
use farm_lab::media_file::{MediaChart, MediaFile};
use farm_lab::slabs::NamedSlab;
use nalgebra::{DMatrix, Matrix3, SymmetricEigen};
use optics_chart::{difference, lab};
use optics_layers::{ChangeSource, Predicted};

/// Factor on the error where a chart of one layer height is used for layers of another.
const OTHER_LAYERS: f64 = 2.0;
/// Step of slopes of colours.
const STEP: f64 = 1e-5;

/// The error of a chart's model, for a print's channels.
#[derive(Debug)]
pub(crate) struct ModelError<'a> {
    chart: &'a MediaChart,
    /// For each channel of the chart, its number in the print.
    places: Vec<Option<usize>>,
    /// Columns of changes by one standard deviation of independent directions.
    root: DMatrix<f64>,
}

impl<'a> ModelError<'a> {
    /// None if the media are not from a chart, or its patches were too few to show the error.
    pub(crate) fn new(file: &'a MediaFile, channels: &[&str]) -> Option<Self> {
        let chart = file.chart.as_ref().filter(|chart| !chart.model_error.is_empty())?;
        let n = chart.model_error.len();
        let covariance = DMatrix::from_fn(n, n, |i, j| chart.model_error[i][j]);
        let eigen = SymmetricEigen::new(covariance);
        let root =
            DMatrix::from_fn(n, n, |i, k| eigen.eigenvectors[(i, k)] * eigen.eigenvalues[k].max(0.0).sqrt());
        let names = file.materials.first()?.channels.iter().map(|c| c.channel.as_str());
        let places = names.map(|name| channels.iter().position(|channel| *channel == name)).collect();
        Some(Self { chart, places, root })
    }

    /// Adds the changes to a print's radiance factors, by channel and base.
    pub(crate) fn add(&self, slabs: &[NamedSlab], found: &mut [Vec<Predicted>]) {
        let factor = if other_layers(self.chart, slabs).is_some() { OTHER_LAYERS } else { 1.0 };
        for base in 0..found.first().map_or(0, Vec::len) {
            let values: Vec<Option<f64>> =
                self.places.iter().map(|place| place.map(|channel| found[channel][base].value)).collect();
            let Some(changes) = self.changes(&values) else { continue };
            for (row, channel) in self.places.iter().enumerate().filter_map(|(i, place)| Some((i, (*place)?)))
            {
                let own = (0..changes.ncols()).map(|k| (ChangeSource::Model(k), factor * changes[(row, k)]));
                found[channel][base].changes.extend(own);
            }
        }
    }

    /// Changes of the radiance factors of a chart's channels by one standard deviation of each direction.
    fn changes(&self, values: &[Option<f64>]) -> Option<DMatrix<f64>> {
        let Some(matrix) = &self.chart.matrix else {
            // Those of logarithms.
            let n = self.root.nrows();
            return Some(DMatrix::from_fn(n, n, |i, k| values[i].unwrap_or(0.0) * self.root[(i, k)]));
        };
        let v: Vec<f64> = values.iter().copied().collect::<Option<_>>()?;
        let matrix = Matrix3::from_fn(|i, j| matrix[i][j]);
        let rgb = matrix * nalgebra::Vector3::from_fn(|i, _| v[i] + self.chart.sheen);
        let here = lab(rgb.into());
        let slopes = Matrix3::from_columns(&[0, 1, 2].map(|i| {
            let mut moved = rgb;
            moved[i] += STEP;
            nalgebra::Vector3::from(difference(here, lab(moved.into()))) / STEP
        }));
        let back = (slopes * matrix).try_inverse()?;
        Some(DMatrix::from_fn(3, 3, |i, k| (0..3).map(|j| back[(i, j)] * self.root[(j, k)]).sum()))
    }
}

/// A layer of a print that is no multiple of those of a chart of one layer height.
fn other_layers(chart: &MediaChart, slabs: &[NamedSlab]) -> Option<f64> {
    let [layer_mm] = chart.layers_mm[..] else { return None };
    // The lowest of several slabs is a base.
    let printed = if slabs.len() > 1 { &slabs[..slabs.len() - 1] } else { slabs };
    printed.iter().map(|slab| slab.thickness_mm).find(|mm| !is_multiple(*mm, layer_mm))
}

/// A sentence on the error of a print's colour after its chart.
pub(crate) fn remark(file: &MediaFile, slabs: &[NamedSlab]) -> Option<String> {
    let chart = file.chart.as_ref()?;
    match other_layers(chart, slabs) {
        Some(mm) => Some(format!(
            "the chart has layers of {} mm only: for {mm} mm its error of predictions is doubled",
            chart.layers_mm[0]
        )),
        None if chart.model_error.is_empty() => {
            Some("the chart has too few patches to show how well it predicts: intervals are those of its media".to_owned())
        }
        None => Some(chart.delta_e_2000_below.map_or_else(
            || "the chart has too few patches to show how well it predicts: an error of 1.5 units of CIEDE2000, or the \
                errors of its media, are assumed".to_owned(),
            |below| format!("95 % of stacks like those of the chart differ from their predictions by less than CIEDE2000 {below:.1}"),
        )).filter(|_| chart.matrix.is_some()),
    }
}
