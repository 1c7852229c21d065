//! What the kernels hand to the tally: the walks of a chunk that have left into the light's ring.

/// A run of walks with streams of their own; the unit in which walks are traced and their sums merged.
#[derive(Debug, Clone, Copy)]
pub struct Chunk {
    /// Key of the transport point's streams.
    pub key: [u32; 2],
    pub index: u64,
    pub walks: u32,
}

/// A walk that has left through the top into the ring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exit<'a> {
    /// Place in the chunk.
    pub walk: u32,
    pub weight: f32,
    pub scatterings: u32,
    pub length_mm: f32,
    /// Lateral offsets of the hits on the base, in their order.
    pub hits_mm: &'a [f32],
}

#[derive(Debug, Clone, Copy)]
struct Row {
    walk: u32,
    weight: f32,
    scatterings: u32,
    length_mm: f32,
    hits: usize,
    hits_end: usize,
}

/// The exits of a chunk, in any order.
#[derive(Debug, Default)]
pub struct Exits {
    rows: Vec<Row>,
    hits_mm: Vec<f32>,
    /// For `in_order`: one more than the row of each walk, or 0.
    places: Vec<u32>,
}

impl Exits {
    /// Starts a list of hits and returns its place.
    pub fn begin(&mut self) -> usize {
        self.hits_mm.len()
    }

    pub fn hit(&mut self, x_mm: f32) {
        self.hits_mm.push(x_mm);
    }

    /// The hits since `begin` belong to no exit.
    pub fn forget(&mut self, hits: usize) {
        self.hits_mm.truncate(hits);
    }

    /// Hits since `begin`, for one who has them in another order.
    pub fn hits_since(&mut self, hits: usize) -> &mut [f32] {
        &mut self.hits_mm[hits..]
    }

    /// Adds an exit with the hits since `begin`.
    pub fn end(&mut self, hits: usize, walk: u32, weight: f32, scatterings: u32, length_mm: f32) {
        let hits_end = self.hits_mm.len();
        self.rows.push(Row { walk, weight, scatterings, length_mm, hits, hits_end });
    }

    /// The exits by walk, whatever the order in which they came.
    pub fn in_order(&mut self, walks: u32) -> impl Iterator<Item = Exit<'_>> {
        self.places.clear();
        self.places.resize(walks as usize, 0);
        for (row, place) in self.rows.iter().zip(1..) {
            self.places[row.walk as usize] = place;
        }
        let (rows, hits_mm) = (&self.rows, &self.hits_mm);
        self.places.iter().filter(|&&place| place > 0).map(move |&place| {
            let Row { walk, weight, scatterings, length_mm, hits, hits_end } = rows[place as usize - 1];
            Exit { walk, weight, scatterings, length_mm, hits_mm: &hits_mm[hits..hits_end] }
        })
    }
}
