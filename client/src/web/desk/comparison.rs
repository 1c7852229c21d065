//! Compares the media of two measurements.

use anyhow::{Result, bail};
use farm_lab::media_file::MediaFile;
use optics_model::Invalid;

use super::api::{CompareRequest, CompareResponse, ComparedRow, MediaRequest, NumberWithInterval};
use super::prints::measured;
use crate::prints::comparison::{ComparedChannel, ComparedQuantity, compared};

pub(super) fn compare(request: CompareRequest) -> Result<CompareResponse> {
    let mut found = compared(&media("a", request.a)?, &media("b", request.b)?)?;
    if request.same_profiles {
        found = found.of_same_profiles();
    }
    // σ_s(1 − g) and σ_a alone are shared by similar media.
    let rows = found.channels.iter().flat_map(|c| c.quantities.iter().take(2).map(|q| row(c, q))).collect();
    Ok(CompareResponse { rows, conclusion: found.conclusion(), unmatched: found.unmatched })
}

fn media(field: &str, request: Option<MediaRequest>) -> Result<MediaFile> {
    let Some(request) = request else { bail!(Invalid::new(field, "nothing", "an answer is needed")) };
    let (found, Some((name, grid))) = measured(request)? else {
        bail!(Invalid::new(format!("{field}.grid"), "nothing", "the grid of the dictionary is needed"))
    };
    Ok(found.media_file(&name, &grid))
}

fn row(channel: &ComparedChannel, quantity: &ComparedQuantity) -> ComparedRow {
    let [a, b, e_n, value, interval] = quantity.texts();
    ComparedRow {
        material: channel.material.clone(),
        channel: channel.channel.clone(),
        quantity: quantity.quantity.to_owned(),
        a,
        b,
        e_n,
        pooled: Some(NumberWithInterval { value, interval }),
        differs: quantity.differs(),
    }
}
