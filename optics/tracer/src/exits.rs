//! Collects the vertices that the walks of a chunk have picked, which the kernels pass to the tally.

use std::ops::Range;

use super::pick::Pick;

/// A run of walks with streams of their own; the unit in which walks are traced and their sums merged.
#[derive(Debug, Clone, Copy)]
pub struct Chunk {
    /// Key of the transport point's streams.
    pub key: [u32; 2],
    pub index: u64,
    pub walks: u32,
}

/// Lateral distance from the entry point of a walk.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Offset {
    /// Gathered in the sample, in mean free paths.
    pub free_paths: f32,
    /// Gathered in clear slabs.
    pub mm: f32,
}

/// A vertex with the hits on the base that led to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Exit {
    pub pick: Pick,
    /// Lateral offsets among [`Exits::hits`], in the order of the hits.
    pub hits: Range<u32>,
}

/// Number of picks of a walk, and the start of its hits.
#[derive(Debug, Clone, Copy, Default)]
struct WalkExits {
    picks: u32,
    hits: u32,
}

/// The exits of a chunk.
#[derive(Debug, Default)]
pub struct Exits {
    picks: Vec<Pick>,
    hits: Vec<Offset>,
    walks: Vec<WalkExits>,
    /// For `in_order`: indices of picks, walk by walk, and the place for the next pick of each walk.
    order: Vec<u32>,
    next: Vec<u32>,
}

impl Exits {
    /// Starts over, for this many walks.
    pub fn reset(&mut self, walks: u32) {
        self.picks.clear();
        self.hits.clear();
        self.walks.clear();
        self.walks.resize(walks as usize, WalkExits::default());
    }

    /// Adds a vertex. The vertices of one walk must be added in their order, walks in any.
    pub fn pick(&mut self, pick: Pick) {
        self.walks[pick.walk as usize].picks += 1;
        self.picks.push(pick);
    }

    /// Whether the hits of a walk are needed: whether it has picks.
    pub fn needs_hits(&self, walk: u32) -> bool {
        self.walks[walk as usize].picks > 0
    }

    /// Adds the hits of a walk that has ended.
    pub fn add_hits(&mut self, walk: u32, hits: &[Offset]) {
        self.walks[walk as usize].hits = self.hits.len() as u32;
        self.hits.extend_from_slice(hits);
    }

    /// The most scatterings of a vertex.
    pub fn most_scatterings(&self) -> u32 {
        self.picks.iter().map(|pick| pick.scatterings).max().unwrap_or(0)
    }

    /// All hits, of which each exit has a range.
    pub fn hits(&self) -> &[Offset] {
        &self.hits
    }

    /// The exits by walk, whatever the order in which they were added.
    pub fn in_order(&mut self) -> impl Iterator<Item = Exit> {
        let mut first = 0;
        self.next.clear();
        for walk in &self.walks {
            self.next.push(first);
            first += walk.picks;
        }
        self.order.clear();
        self.order.resize(self.picks.len(), 0);
        for (place, pick) in (0..).zip(&self.picks) {
            let next = &mut self.next[pick.walk as usize];
            self.order[*next as usize] = place;
            *next += 1;
        }
        let (picks, walks) = (&self.picks, &self.walks);
        self.order.iter().map(move |&place| {
            let pick = picks[place as usize];
            let begin = walks[pick.walk as usize].hits;
            Exit { pick, hits: begin..begin + pick.hits }
        })
    }
}
