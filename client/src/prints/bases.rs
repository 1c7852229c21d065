//! Lambertian bases under prints, by names or reflectances.

use anyhow::Result;
use optics_model::{Invalid, Scene};
use serde::Serialize;

use super::set_up::FoundSetUp;

/// Reflectances of the bases called black and white: of usual backings (ISO 13655 asks for matt, neutral ones).
const BASES: [(&str, f64); 2] = [("black", 0.03), ("white", 0.9)];

/// A base under a print.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub(crate) struct PrintBase {
    pub(crate) name: String,
    #[serde(skip)]
    kind: BaseKind,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum BaseKind {
    Neutral(f64),
    /// A side of the board of the measurement.
    Light,
    Dark,
}

impl PrintBase {
    pub(crate) fn parsed(text: &str) -> Result<Self, Invalid> {
        let named = BASES.iter().find(|(name, _)| *name == text).map(|(_, rho)| BaseKind::Neutral(*rho));
        let number = || text.parse().ok().filter(|rho| (0.0..=1.0).contains(rho)).map(BaseKind::Neutral);
        let kind = match text {
            "light" => BaseKind::Light,
            "dark" => BaseKind::Dark,
            _ => named.or_else(number).ok_or_else(|| {
                let allowed = "allowed are black (0.03), white (0.9), reflectances from 0 to 1, and light and dark, the \
                               sides of the measured board";
                Invalid::new("over", text, allowed)
            })?,
        };
        Ok(Self { name: text.to_owned(), kind })
    }

    /// Reflectances in a channel, seen through a scene.
    pub(crate) fn all_rho(
        bases: &[Self],
        set_up: &FoundSetUp,
        channel: &str,
        scene: &Scene,
    ) -> Result<Vec<f64>> {
        let is_board = |base: &Self| !matches!(base.kind, BaseKind::Neutral(_));
        let board =
            if bases.iter().any(is_board) { set_up.board(channel, scene)? } else { Default::default() };
        let rho = |base: &Self| match base.kind {
            BaseKind::Neutral(rho) => rho,
            BaseKind::Light => board[0],
            BaseKind::Dark => board[1],
        };
        Ok(bases.iter().map(rho).collect())
    }
}
