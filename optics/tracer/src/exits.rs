//! What the kernels hand to the tally: what the walks of a chunk have met of the light.

use super::light::Light;
use super::pick::Pick;

/// A run of walks with streams of their own; the unit in which walks are traced and their sums merged.
#[derive(Debug, Clone, Copy)]
pub struct Chunk {
    /// Key of the transport point's streams.
    pub key: [u32; 2],
    pub index: u64,
    pub walks: u32,
}

/// Albedos that something counts for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Albedos {
    All,
    /// One of [`crate::pick`]'s groups, for which the weight is that of its reference.
    Group(usize),
}

/// Light that a walk has met: at one of its vertices, or in the ring if it has left into it without any.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exit<'a> {
    /// Place in the chunk.
    pub walk: u32,
    pub albedos: Albedos,
    pub weight: f64,
    /// Scatterings up to there.
    pub scatterings: u32,
    /// Length in the sample, of walk and light, if derivatives are wanted.
    pub length_mm: f32,
    /// Lateral offsets of the hits on the base up to there, in their order.
    pub hits_mm: &'a [f32],
}

#[derive(Debug, Clone, Copy)]
struct Row {
    albedos: Albedos,
    weight: f64,
    scatterings: u32,
    length_mm: f32,
    hits: u32,
}

/// Rows of a walk.
#[derive(Debug, Clone, Copy, Default)]
struct Rows {
    begin: u32,
    end: u32,
    /// Where its hits begin.
    hits: u32,
}

/// The exits of a chunk, walk by walk in any order.
#[derive(Debug)]
pub struct Exits {
    rows: Vec<Row>,
    hits_mm: Vec<f32>,
    walks: Vec<Rows>,
}

impl Exits {
    /// For so many walks.
    pub fn new(walks: u32) -> Self {
        Self { rows: Vec::new(), hits_mm: Vec::new(), walks: vec![Rows::default(); walks as usize] }
    }

    /// Adds a walk that has ended: its hits, the vertices that it has kept, and its weight if it has left into the ring and
    /// met no vertex.
    pub fn end(
        &mut self,
        walk: u32,
        hits_mm: impl Iterator<Item = f32>,
        kept: impl Iterator<Item = (usize, f32, Pick)>,
        straight: Option<f32>,
        light: &Light,
    ) {
        let (begin, hits) = (self.rows.len() as u32, self.hits_mm.len() as u32);
        for (group, sum, pick) in kept {
            let (factor, length_mm) = pick.corrected(light);
            let (albedos, weight) = (Albedos::Group(group), f64::from(sum) * factor);
            let Pick { scatterings, hits, .. } = pick;
            self.rows.push(Row { albedos, weight, scatterings, length_mm, hits });
        }
        if let Some(weight) = straight {
            let weight = f64::from(weight);
            self.rows.push(Row { albedos: Albedos::All, weight, scatterings: 0, length_mm: 0.0, hits: 0 });
        }
        if self.rows.len() as u32 > begin {
            self.hits_mm.extend(hits_mm);
            self.walks[walk as usize] = Rows { begin, end: self.rows.len() as u32, hits };
        }
    }

    /// The exits by walk, whatever the order in which they came.
    pub fn in_order(&self) -> impl Iterator<Item = Exit<'_>> {
        let of_walk = move |(walk, rows): (u32, &Rows)| {
            let hits = rows.hits as usize;
            self.rows[rows.begin as usize..rows.end as usize].iter().map(move |row| {
                let &Row { albedos, weight, scatterings, length_mm, hits: count } = row;
                let hits_mm = &self.hits_mm[hits..hits + count as usize];
                Exit { walk, albedos, weight, scatterings, length_mm, hits_mm }
            })
        };
        (0..).zip(&self.walks).flat_map(of_walk)
    }
}
