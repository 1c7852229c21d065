//! Stores the hits on the base of the walks that are under way: one linked list per walk, in an arena that is reused.

use crate::exits::Offset;

const NONE: u32 = u32::MAX;

#[derive(Debug, Clone, Copy)]
struct HitNode {
    hit: Offset,
    next: u32,
}

/// Lists of lateral offsets, by walk. Nodes of ended walks are reused, so that the arena grows with the walks under way
/// only.
#[derive(Debug)]
pub struct Hits {
    nodes: Vec<HitNode>,
    free: u32,
    /// Newest node of each walk, and its number of nodes.
    heads: Vec<(u32, u32)>,
}

impl Hits {
    pub fn new() -> Self {
        Self { nodes: Vec::new(), free: NONE, heads: Vec::new() }
    }

    /// Starts over, for this many walks.
    pub fn reset(&mut self, walks: u32) {
        self.nodes.clear();
        self.free = NONE;
        self.heads.clear();
        self.heads.resize(walks as usize, (NONE, 0));
    }

    pub fn count(&self, walk: u32) -> u32 {
        self.heads[walk as usize].1
    }

    pub fn push(&mut self, walk: u32, hit: Offset) {
        let (head, count) = &mut self.heads[walk as usize];
        *count += 1;
        let node = HitNode { hit, next: *head };
        if self.free == NONE {
            *head = self.nodes.len() as u32;
            self.nodes.push(node);
        } else {
            *head = self.free;
            let place = &mut self.nodes[self.free as usize];
            self.free = place.next;
            *place = node;
        }
    }

    /// Takes a walk's hits away, oldest first.
    pub fn take(&mut self, walk: u32, hits: &mut Vec<Offset>) {
        hits.clear();
        self.end(walk, |hit| hits.push(hit));
        hits.reverse();
    }

    /// Passes a walk's hits to `each`, newest first, and frees their nodes.
    fn end(&mut self, walk: u32, mut each: impl FnMut(Offset)) {
        let (head, _) = std::mem::replace(&mut self.heads[walk as usize], (NONE, 0));
        let (mut at, mut last) = (head, NONE);
        while at != NONE {
            let node = self.nodes[at as usize];
            each(node.hit);
            (at, last) = (node.next, at);
        }
        if last != NONE {
            self.nodes[last as usize].next = self.free;
            self.free = head;
        }
    }
}
