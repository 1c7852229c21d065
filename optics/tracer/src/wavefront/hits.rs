//! Hits on the base of the walks that are under way: one linked list a walk, in an arena that is used again.

use crate::exits::Exits;

const NONE: u32 = u32::MAX;

#[derive(Debug, Clone, Copy)]
struct Node {
    x_mm: f32,
    next: u32,
}

/// Lists of lateral offsets, by walk. Nodes of ended walks are used again, so that the arena holds no more than what
/// is under way.
#[derive(Debug)]
pub struct Hits {
    nodes: Vec<Node>,
    free: u32,
    heads: Vec<u32>,
}

impl Hits {
    pub fn new(walks: u32) -> Self {
        Self { nodes: Vec::new(), free: NONE, heads: vec![NONE; walks as usize] }
    }

    pub fn push(&mut self, walk: u32, x_mm: f32) {
        let head = &mut self.heads[walk as usize];
        let node = Node { x_mm, next: *head };
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

    /// Moves a walk's hits to the end of `exits`, oldest first, and forgets them here.
    pub fn move_to(&mut self, walk: u32, exits: &mut Exits) {
        let begin = exits.begin();
        self.end(walk, |x_mm| exits.hit(x_mm));
        exits.hits_since(begin).reverse();
    }

    /// Forgets a walk's hits.
    pub fn forget(&mut self, walk: u32) {
        self.end(walk, |_| {});
    }

    /// Shows a walk's hits, newest first, and puts their nodes back.
    fn end(&mut self, walk: u32, mut each: impl FnMut(f32)) {
        let head = std::mem::replace(&mut self.heads[walk as usize], NONE);
        let (mut at, mut last) = (head, NONE);
        while at != NONE {
            let node = self.nodes[at as usize];
            each(node.x_mm);
            (at, last) = (node.next, at);
        }
        if last != NONE {
            self.nodes[last as usize].next = self.free;
            self.free = head;
        }
    }
}
