//! A photograph before its calibration, with black level and flat.

use crate::black::Black;
use crate::flat::Flat;
use crate::frame::{Colour, Frame, Photo, Site};

/// A photograph with the black level and the flat for reading its samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PhotoView<'a> {
    pub photo: &'a Photo,
    pub black: &'a Black,
    pub flat: &'a Flat,
}

impl PhotoView<'_> {
    pub fn frame(&self) -> &Frame {
        &self.photo.frame
    }

    /// Number above black level.
    pub fn signal(&self, site: Site, x: usize, y: usize) -> f64 {
        self.black.signal(&self.photo.frame, site, x, y)
    }

    /// The column in which edges are looked for.
    pub fn sharpest(&self) -> Colour {
        self.photo.frame.pattern().sharpest()
    }

    /// Relative brightness of its light at a place.
    pub fn light(&self, [x, y]: [f64; 2]) -> f64 {
        self.flat.at(self.sharpest(), x, y)
    }
}
