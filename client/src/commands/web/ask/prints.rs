//! Predicts prints of measured media, and compares the media of two measurements that are kept.

use anyhow::{Result, bail};
use farm_lab::colour::{Illuminant, StandardObserver, Viewing};
use farm_lab::media_file::MediaFile;
use optics_model::{Invalid, Measurement};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::task::block_in_place;

use super::PageState;
use super::measure::kept;
use crate::commands::measurements::kept::KeptAnswer;
use crate::output::envelope;
use crate::prints::comparison::{Comparison, compared};
use crate::prints::geometry::Geometry;
use crate::prints::prediction::{PredictJson, predicted};
use crate::prints::view::ViewOptions;

/// Inputs of `farmctl predict` by the names of its options.
#[derive(Debug, Deserialize)]
pub(super) struct PredictInputs {
    /// The contents of media.json.
    media: Value,
    slabs: Vec<String>,
    over: Vec<String>,
    geometry: Geometry,
}

pub(super) fn predict(asked: PredictInputs) -> Result<PredictJson> {
    let PredictInputs { media, slabs, over, geometry } = asked;
    if slabs.is_empty() {
        bail!(Invalid::new("slabs", "none", "a print has at least one slab"));
    }
    let viewing = Viewing { illuminant: Illuminant::D50, observer: StandardObserver::TwoDegrees };
    predicted(
        &MediaFile::from_json(media)?,
        &slabs,
        &over,
        &ViewOptions { geometry, roughness: None, viewing },
    )
}

/// Ids of two measurements.
#[derive(Debug, Deserialize)]
pub(super) struct ComparedPair {
    a: String,
    b: String,
}

/// The answer of `farmctl compare`, with its conclusion.
pub(super) async fn compare(state: &PageState, asked: &ComparedPair) -> Result<String> {
    #[derive(Serialize)]
    struct ComparedJson {
        #[serde(flatten)]
        compared: Comparison,
        conclusion: String,
        titles: [String; 2],
    }
    let (a, b) = (kept(state, &asked.a).await?, kept(state, &asked.b).await?);
    block_in_place(|| {
        let media = |kept: &KeptAnswer| kept.found.media_file(&kept.request.dictionary, &kept.grid);
        let mut compared = compared(&media(&a), &media(&b))?;
        if profiles(&a).eq(profiles(&b)) {
            compared = compared.of_same_profiles();
        }
        let conclusion = compared.conclusion();
        envelope("compare", &ComparedJson { compared, conclusion, titles: [a, b].map(|k| k.summary.title) })
    })
}

/// The measured values.
fn profiles(kept: &KeptAnswer) -> impl Iterator<Item = (&str, f64, &[f64])> {
    let profiles = kept.materials.iter().flat_map(Measurement::profiles);
    profiles.map(|profile| (profile.channel(), profile.thickness_mm(), profile.values()))
}
