//! The answer of `farmctl predict`: radiance factors and colours of a print over bases, with their errors.

use anyhow::Result;
use farm_lab::colour::{Colorimetry, SeenColour, Viewing};
use farm_lab::media_file::MediaFile;
use optics_layers::Predicted;
use optics_model::Invalid;
use optics_model::fit::Z;
use optics_model::measurement::wavelength_nm;
use serde::Serialize;

use super::bases::PrintBase;
use super::errors::{lab_std_errors, std_error};
use super::slabs::{NamedSlab, parsed};
use super::view::{PrintView, ViewOptions, materials_of, unresolved};

#[derive(Debug, Serialize)]
pub(crate) struct PredictJson {
    pub(crate) slabs: Vec<SlabJson>,
    pub(crate) geometry: &'static str,
    pub(crate) channels: Vec<PredictedChannelJson>,
    /// Null unless the channels are wavelengths that cover the visible range.
    pub(crate) colours: Option<ColoursJson>,
    /// Why there are no colours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) no_colours: Option<String>,
    /// Materials that the measurement leaves undetermined, with their channels.
    pub(crate) unresolved: Vec<String>,
}

#[derive(Debug, Serialize)]
pub(crate) struct SlabJson {
    pub(crate) label: String,
    pub(crate) thickness_mm: f64,
    pub(crate) shares: Vec<ShareJson>,
}

#[derive(Debug, Serialize)]
pub(crate) struct ShareJson {
    pub(crate) material: String,
    pub(crate) share: f64,
}

#[derive(Debug, Serialize)]
pub(crate) struct PredictedChannelJson {
    pub(crate) channel: String,
    pub(crate) bases: Vec<ReflectanceJson>,
}

/// A radiance factor with its 95 % interval.
#[derive(Debug, Serialize)]
pub(crate) struct ReflectanceJson {
    pub(crate) base: PrintBase,
    pub(crate) radiance_factor: f64,
    pub(crate) std_error: f64,
    pub(crate) interval: [f64; 2],
}

#[derive(Debug, Serialize)]
pub(crate) struct ColoursJson {
    #[serde(flatten)]
    pub(crate) viewing: Viewing,
    pub(crate) bases: Vec<ColourJson>,
    /// Least Y over all bases over the greatest, and its standard error; null with one base.
    pub(crate) contrast_ratio: Option<[f64; 2]>,
}

#[derive(Debug, Serialize)]
pub(crate) struct ColourJson {
    pub(crate) base: PrintBase,
    #[serde(flatten)]
    pub(crate) colour: SeenColour,
    pub(crate) lab_std_errors: [f64; 3],
    /// Null for the 10° observer.
    pub(crate) srgb: Option<[u8; 3]>,
}

/// The prediction for slabs and bases as they are typed.
pub(crate) fn predicted(
    file: &MediaFile,
    slabs: &[String],
    over: &[String],
    options: &ViewOptions,
) -> Result<PredictJson> {
    let is_material = |name: &str| file.material(name).is_ok();
    let slabs: Vec<NamedSlab> = slabs.iter().map(|text| parsed(text, is_material)).collect::<Result<_>>()?;
    let bases: Vec<PrintBase> =
        over.iter().map(|text| PrintBase::parsed(text.trim())).collect::<Result<_, _>>()?;
    let materials = materials_of(&slabs);
    let view = PrintView::new(file, &slabs, &bases, options)?;
    let channels = view.names();
    let found = view.predicted(&slabs)?;
    let unresolved = unresolved(file, &materials, &channels)?;
    let (colours, no_colours) = match colours(&channels, &found, &bases, options.viewing) {
        Ok(colours) => (Some(colours), None),
        Err(reason) if wavelength_nm(channels[0]).is_none() => (None, Some(reason.allowed().to_owned())),
        Err(reason) => (None, Some(format!("{}: {}", reason.given(), reason.allowed()))),
    };
    Ok(PredictJson {
        slabs: slabs.iter().map(slab_json).collect(),
        geometry: options.geometry.name(),
        channels: channels
            .iter()
            .zip(&found)
            .map(|(channel, found)| channel_json(channel, found, &bases))
            .collect(),
        colours,
        no_colours,
        unresolved,
    })
}

fn slab_json(slab: &NamedSlab) -> SlabJson {
    let share = |(material, share): &(String, f64)| ShareJson { material: material.clone(), share: *share };
    SlabJson {
        label: slab.label(),
        thickness_mm: slab.thickness_mm,
        shares: slab.shares.iter().map(share).collect(),
    }
}

fn channel_json(channel: &str, found: &[Predicted], bases: &[PrintBase]) -> PredictedChannelJson {
    let reflectance = |(found, base): (&Predicted, &PrintBase)| {
        let (value, std_error) = (found.value, found.std_error());
        let interval = [(value - Z * std_error).max(0.0), value + Z * std_error];
        ReflectanceJson { base: base.clone(), radiance_factor: value, std_error, interval }
    };
    PredictedChannelJson {
        channel: channel.to_owned(),
        bases: found.iter().zip(bases).map(reflectance).collect(),
    }
}

/// Colours over all bases.
fn colours(
    channels: &[&str],
    found: &[Vec<Predicted>],
    bases: &[PrintBase],
    viewing: Viewing,
) -> Result<ColoursJson, Invalid> {
    let wavelengths: Option<Vec<f64>> = channels.iter().map(|channel| wavelength_nm(channel)).collect();
    let mut sorted: Vec<(f64, usize)> =
        wavelengths.unwrap_or_default().into_iter().enumerate().map(|(i, nm)| (nm, i)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (nm, order): (Vec<f64>, Vec<usize>) = sorted.into_iter().unzip();
    let colorimetry = Colorimetry::new(&nm, viewing)?;
    let colour = |(i, base): (usize, &PrintBase)| {
        let values: Vec<f64> = order.iter().map(|channel| found[*channel][i].value).collect();
        let colour = colorimetry.colour(&values);
        ColourJson {
            base: base.clone(),
            colour,
            lab_std_errors: lab_std_errors(&colorimetry, found, &order, i),
            srgb: colorimetry.srgb(&colour),
        }
    };
    let all: Vec<ColourJson> = bases.iter().enumerate().map(colour).collect();
    let contrast_ratio = (all.len() > 1).then(|| contrast_ratio(&colorimetry, found, &order, &all));
    Ok(ColoursJson { viewing, bases: all, contrast_ratio })
}

/// Least Y over the greatest, q = Y₁/Y₂, and its standard error, by dq = (dY₁ − q dY₂)/Y₂.
fn contrast_ratio(
    colorimetry: &Colorimetry,
    found: &[Vec<Predicted>],
    order: &[usize],
    colours: &[ColourJson],
) -> [f64; 2] {
    let y = |base: &usize| colours[*base].colour.xyz[1];
    let all = || 0..colours.len();
    let least = all().min_by(|a, b| y(a).total_cmp(&y(b))).unwrap_or(0);
    let greatest = all().max_by(|a, b| y(a).total_cmp(&y(b))).unwrap_or(0);
    let ratio = y(&least) / y(&greatest);
    // Y is linear in the spectrum.
    let mut weights = vec![0.0; found.len()];
    for (at, channel) in order.iter().enumerate() {
        let unit: Vec<f64> = (0..order.len()).map(|i| if i == at { 1.0 } else { 0.0 }).collect();
        weights[*channel] = colorimetry.xyz(&unit)[1] / y(&greatest);
    }
    let error = std_error(found, |channel, base| match base {
        _ if base == least => weights[channel],
        _ if base == greatest => -ratio * weights[channel],
        _ => 0.0,
    });
    [ratio, if least == greatest { 0.0 } else { error }]
}

/// Decimals of a radiance factor: its error has two digits.
pub(crate) fn decimals(std_error: f64) -> usize {
    (-std_error.max(1e-5).log10().floor()).clamp(2.0, 6.0) as usize + 1
}
