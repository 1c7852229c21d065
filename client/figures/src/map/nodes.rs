//! Maps the irregular axes of the grid to cells.

use anyhow::bail;

use crate::drawing::axis::Axis;

/// Nodes of an axis, each with its cell between the geometric midpoints to its neighbours.
pub(super) struct Nodes {
    pub(super) axis: Axis,
    /// Indices into the data, in ascending order of the values.
    order: Vec<usize>,
    /// Upper edges of all cells but the last, as fractions of the axis.
    edges: Vec<f64>,
}

impl Nodes {
    pub(super) fn new(values: impl Iterator<Item = f64>) -> anyhow::Result<Self> {
        let values: Vec<_> = values.collect();
        let mut order: Vec<usize> =
            (0..values.len()).filter(|&i| values[i].is_finite() && values[i] > 0.0).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let sorted: Vec<_> = order.iter().map(|&i| values[i]).collect();
        let (Some(first), Some(last)) = (sorted.first(), sorted.last()) else {
            bail!("none has a place on a logarithmic axis");
        };
        let middles: Vec<_> = sorted.windows(2).map(|pair| (pair[0] * pair[1]).sqrt()).collect();
        let low = middles.first().map_or(first / 1.25, |middle| first * first / middle);
        let high = middles.last().map_or(last * 1.25, |middle| last * last / middle);
        let axis = Axis::logarithmic(low, high);
        let edges = middles.iter().map(|&middle| axis.fraction(middle)).collect();
        Ok(Self { axis, order, edges })
    }

    /// Index of the value whose cell covers a position on the axis.
    pub(super) fn index(&self, fraction: f64) -> usize {
        self.order[self.edges.partition_point(|&edge| edge < fraction)]
    }
}
