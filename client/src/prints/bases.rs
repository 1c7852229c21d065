//! Lambertian bases under prints, by names or reflectances.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use farm_lab::chart::NAMED_BASES;
use optics_model::{Invalid, Scene};
use serde::Serialize;

use super::set_up::FoundSetUp;

/// A base under a print.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub(crate) struct PrintBase {
    pub(crate) name: String,
    #[serde(skip)]
    kind: BaseKind,
}

#[derive(Debug, Clone, PartialEq)]
enum BaseKind {
    Neutral(f64),
    /// By channel, and `all` for the others.
    ByChannel(BTreeMap<String, f64>),
    /// A side of the board of the measurement.
    Light,
    Dark,
}

impl PrintBase {
    pub(crate) fn parsed(text: &str) -> Result<Self, Invalid> {
        let named =
            NAMED_BASES.iter().find(|(name, _)| *name == text).map(|(_, rho)| BaseKind::Neutral(*rho));
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

    /// The base of a chart's settings: reflectances by channel, and `all` for the others.
    pub(crate) fn by_channel(rho: &BTreeMap<String, f64>) -> Self {
        Self { name: "base".to_owned(), kind: BaseKind::ByChannel(rho.clone()) }
    }

    /// Reflectances in a channel, seen through a scene.
    pub(crate) fn all_rho(
        bases: &[Self],
        set_up: &FoundSetUp,
        channel: &str,
        scene: &Scene,
    ) -> Result<Vec<f64>> {
        let is_board = |base: &Self| matches!(base.kind, BaseKind::Light | BaseKind::Dark);
        let board =
            if bases.iter().any(is_board) { set_up.board(channel, scene)? } else { Default::default() };
        let rho = |base: &Self| match &base.kind {
            BaseKind::Neutral(rho) => Ok(*rho),
            BaseKind::ByChannel(rho) => {
                let found = rho.get(channel).or_else(|| rho.get("all")).copied();
                found.with_context(|| format!("base: no reflectance for channel {channel}, nor for all"))
            }
            BaseKind::Light => Ok(board[0]),
            BaseKind::Dark => Ok(board[1]),
        };
        bases.iter().map(rho).collect()
    }
}
