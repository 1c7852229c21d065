//! Prepares vertices for scoring: the weights of picks, which depend on the point through its light alone.

use super::exits::{Exit, Exits, Offset};
use super::light::Light;
use super::pick::{AT_BASE, STEP};
use super::scatterings::{WINDOW, shares};

/// A vertex, the same for all points that share its walk.
#[derive(Debug, Clone, Copy)]
pub struct Vertex {
    /// Place of the walk in its chunk.
    pub walk: u32,
    /// First of the nodes that the vertex is distributed over, see [`crate::scatterings`].
    pub first_node: u32,
    /// Weight of each of these nodes, the same for the walk and for its mirror image.
    pub weights: [f32; WINDOW],
    /// Length in the sample of the walk and its light, in mean free paths; without that of the light if no derivatives
    /// are requested.
    pub length: f32,
    first_hit: u32,
    hits: u32,
}

impl Vertex {
    fn new(exit: &Exit, light: &Light) -> Self {
        let pick = &exit.pick;
        let (receives, light_length) =
            if pick.z == AT_BASE { light.at_base() } else { light.at(pick.z, pick.u) };
        let step = f64::from(STEP * light.measure);
        let weight = 0.5 * f64::from(pick.cuts) * step * receives / f64::from(pick.worth);
        let (first, shares) = shares(pick.scatterings);
        Self {
            walk: pick.walk,
            first_node: first as u32,
            weights: shares.map(|share| (share * weight) as f32),
            length: pick.length + light_length,
            first_hit: exit.hits.start,
            hits: exit.hits.end - exit.hits.start,
        }
    }

    /// The hits that led to the vertex.
    pub fn hits<'h>(&self, hits: &'h [Offset]) -> &'h [Offset] {
        &hits[self.first_hit as usize..][..self.hits as usize]
    }
}

/// The vertices of a chunk, by walk.
#[derive(Debug, Default)]
pub struct Vertices {
    pub all: Vec<Vertex>,
    /// The most scatterings and hits of one.
    pub most_scatterings: u32,
    pub most_hits: u32,
}

impl Vertices {
    /// Prepares the vertices that walks have picked.
    pub fn set(&mut self, exits: &mut Exits, light: &Light) {
        self.most_scatterings = exits.most_scatterings();
        self.all.clear();
        self.all.extend(exits.in_order().map(|exit| Vertex::new(&exit, light)));
        self.most_hits = self.all.iter().map(|vertex| vertex.hits).max().unwrap_or(0);
    }
}
