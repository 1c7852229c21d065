//! Questions to a dictionary and their answers.

use crate::ids::RequestLimits;
use crate::invalid::{Invalid, Result, check};
use crate::optics::{Medium, check_g};

/// Settings of Eqs. 1 and 2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    lambda: f64,
    mu: f64,
    g: Option<f64>,
    top: usize,
}

impl FitOptions {
    /// `lambda` weighs the gradient term, `mu` scales the measured values, `g` fixes the anisotropy,
    /// `top` is the number of neighbours wanted.
    pub fn new(lambda: f64, mu: f64, g: Option<f64>, top: u32) -> Result<Self> {
        if !(1..=RequestLimits::TOP).contains(&top) {
            return Err(Invalid::new("top", top, format!("allowed are 1 to {}", RequestLimits::TOP)));
        }
        Ok(Self {
            lambda: check("lambda", lambda, |v| (0.0..=1e9).contains(&v), "allowed are 0 to 1e9")?,
            mu: check("mu", mu, |v| v > 0.0 && v <= 1e3, "allowed are numbers above 0, at most 1000")?,
            g: g.map(check_g).transpose()?,
            top: top as usize,
        })
    }

    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    pub fn mu(&self) -> f64 {
        self.mu
    }

    pub fn g(&self) -> Option<f64> {
        self.g
    }

    pub fn top(&self) -> usize {
        self.top
    }
}

impl Default for FitOptions {
    /// The paper's λ = 20 with μ = 1, g free, five neighbours.
    fn default() -> Self {
        Self { lambda: 20.0, mu: 1.0, g: None, top: 5 }
    }
}

/// One term of Eq. 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThicknessError {
    pub thickness_mm: f64,
    /// Root mean square of μ F_A − F_S.
    pub value_rms: f64,
    /// Root mean square of |∇ μ F_A| − |∇ F_S|, before λ.
    pub gradient_rms: f64,
    /// Number of the record compared with.
    pub record: usize,
}

/// A medium of the dictionary and how well it explains a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    pub medium: Medium,
    pub sample_ior: f64,
    /// Σ over thicknesses of value_rms + λ · gradient_rms.
    pub error: f64,
    pub thicknesses: Vec<ThicknessError>,
}

/// Best candidates of one channel, best first.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelFit {
    pub channel: String,
    pub candidates: Vec<Candidate>,
}
