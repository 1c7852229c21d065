//! Parts that all figures share: canvas, text, axes, frames, legends, and sheets of panels.

pub(crate) mod axis;
pub(crate) mod canvas;
pub(crate) mod curve;
pub(crate) mod frame;
pub(crate) mod head;
pub(crate) mod legend;
pub(crate) mod number;
pub(crate) mod picture;
pub(crate) mod rgb;
pub(crate) mod shape;
pub(crate) mod sheet;
pub(crate) mod text;
