//! What the kernels hand to the tally: the vertices that the walks of a chunk have picked.

use super::pick::Pick;

/// A run of walks with streams of their own; the unit in which walks are traced and their sums merged.
#[derive(Debug, Clone, Copy)]
pub struct Chunk {
    /// Key of the transport point's streams.
    pub key: [u32; 2],
    pub index: u64,
    pub walks: u32,
}

/// A vertex with the hits on the base that led to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exit<'a> {
    pub pick: Pick,
    /// Lateral offsets, in the order of the hits.
    pub hits_mm: &'a [f32],
}

/// Picks of a walk, and where its hits begin.
#[derive(Debug, Clone, Copy, Default)]
struct Walk {
    picks: u32,
    hits: u32,
}

/// The exits of a chunk.
#[derive(Debug)]
pub struct Exits {
    picks: Vec<Pick>,
    hits_mm: Vec<f32>,
    walks: Vec<Walk>,
    /// For `in_order`: places of picks, walk by walk.
    order: Vec<u32>,
}

impl Exits {
    /// For so many walks.
    pub fn new(walks: u32) -> Self {
        let walks = vec![Walk::default(); walks as usize];
        Self { picks: Vec::new(), hits_mm: Vec::new(), walks, order: Vec::new() }
    }

    /// Adds a vertex. Those of one walk come in their order, walks in any.
    pub fn pick(&mut self, pick: Pick) {
        self.walks[pick.walk as usize].picks += 1;
        self.picks.push(pick);
    }

    /// Whether somebody will ask for the hits of a walk.
    pub fn needs_hits(&self, walk: u32) -> bool {
        self.walks[walk as usize].picks > 0
    }

    /// Adds the hits of a walk that has ended.
    pub fn add_hits(&mut self, walk: u32, hits_mm: &[f32]) {
        self.walks[walk as usize].hits = self.hits_mm.len() as u32;
        self.hits_mm.extend_from_slice(hits_mm);
    }

    /// The most scatterings of a vertex.
    pub fn most_scatterings(&self) -> u32 {
        self.picks.iter().map(|pick| pick.scatterings).max().unwrap_or(0)
    }

    /// The exits by walk, whatever the order in which they came.
    pub fn in_order(&mut self) -> impl Iterator<Item = Exit<'_>> {
        let mut first = 0;
        let mut places: Vec<u32> = Vec::with_capacity(self.walks.len());
        for walk in &self.walks {
            places.push(first);
            first += walk.picks;
        }
        self.order.clear();
        self.order.resize(self.picks.len(), 0);
        for (place, pick) in (0..).zip(&self.picks) {
            let next = &mut places[pick.walk as usize];
            self.order[*next as usize] = place;
            *next += 1;
        }
        let (picks, hits_mm, walks) = (&self.picks, &self.hits_mm, &self.walks);
        self.order.iter().map(move |&place| {
            let pick = picks[place as usize];
            let begin = walks[pick.walk as usize].hits as usize;
            Exit { pick, hits_mm: &hits_mm[begin..begin + pick.hits as usize] }
        })
    }
}
