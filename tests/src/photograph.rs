//! Simulates photographs: from exact edges to the sample values of a mosaic, with the faults of a real set-up.
//!
//! Each pixel is the integral of the blurred scene over its area, by Gauss quadrature. Blur is a Gaussian in the
//! board's plane, and is convolved analytically or in a table fine enough for 10⁻⁵.

mod bands;
mod camera;
mod noise;
mod session;
mod session_file;
mod subject;
mod traced;

pub use bands::{BandSession, EXAMPLE_NM, SpectralMaterial, spectral_nm};
pub use camera::{Camera, Dust, Shot, develop, expose};
pub use noise::Random;
pub use session::{Look, Session, What, patches};
pub use session_file::{SessionValues, session_file};
pub use subject::{Board, Edge, Slab, Subject};
pub use traced::{traced, traced_channel};
