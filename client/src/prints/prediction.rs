//! The answer of `farmctl predict`: radiance factors and colours of a print over bases, with their errors.

use anyhow::Result;
use farm_lab::colour::{Colorimetry, SeenColour, Viewing, delta_e_2000};
use farm_lab::media_file::{MediaChart, MediaFile};
use optics_layers::Predicted;
use optics_model::Invalid;
use optics_model::fit::Z;
use optics_model::measurement::wavelength_nm;
use serde::Serialize;

use super::bases::PrintBase;
use super::errors::{lab_std_errors, spectrum, std_error};
use super::model_error::remark;
use super::view::{PrintView, ViewOptions, materials_of, unresolved};
use farm_lab::slabs::{NamedSlab, parsed};

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
    /// A sentence on the error of this print's colour after the chart of the media.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) of_chart: Option<String>,
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
    /// Least Y over all bases over the greatest, and its standard error; null unless bases differ.
    pub(crate) contrast_ratio: Option<[f64; 2]>,
    /// CIEDE2000 between these bases, and its standard error.
    pub(crate) delta_e_2000: Option<[f64; 2]>,
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
    let (colours, no_colours) = match colours(&channels, &found, &bases, file.chart.as_ref(), options.viewing)
    {
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
        of_chart: remark(file, &slabs),
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
    chart: Option<&MediaChart>,
    viewing: Viewing,
) -> Result<ColoursJson, Invalid> {
    let (colorimetry, order) = Colorimetry::for_channels(channels, chart, viewing)?;
    let viewing = colorimetry.viewing();
    let colour = |values: &[Vec<f64>], base: usize| colorimetry.colour(&spectrum(values, &order, base));
    let values: Vec<Vec<f64>> = found.iter().map(|of| of.iter().map(|p| p.value).collect()).collect();
    let base_colour = |(i, base): (usize, &PrintBase)| {
        let colour = colour(&values, i);
        ColourJson {
            base: base.clone(),
            lab_std_errors: lab_std_errors(&colorimetry, found, &order, i),
            srgb: colorimetry.srgb(&colour),
            colour,
        }
    };
    let all: Vec<ColourJson> = bases.iter().enumerate().map(base_colour).collect();
    let y = |base: &usize| all[*base].colour.xyz[1];
    let least = (0..all.len()).min_by(|a, b| y(a).total_cmp(&y(b)));
    let greatest = (0..all.len()).max_by(|a, b| y(a).total_cmp(&y(b)));
    let ends = least.zip(greatest).filter(|(least, greatest)| least != greatest);
    let comparison = |f: fn(&SeenColour, &SeenColour) -> f64| {
        ends.map(|(least, greatest)| {
            let value = |values: &[Vec<f64>]| f(&colour(values, least), &colour(values, greatest));
            [value(&values), std_error(found, value)]
        })
    };
    let contrast_ratio = comparison(|a, b| a.xyz[1] / b.xyz[1]);
    let delta_e_2000 = comparison(|a, b| delta_e_2000(a.lab, b.lab));
    Ok(ColoursJson { viewing, bases: all, contrast_ratio, delta_e_2000 })
}

impl PredictJson {
    /// Lamps and sensor, in words.
    pub(crate) fn seen(&self) -> String {
        match self.geometry {
            "session" => "in the measured set-up".to_owned(),
            other => format!("a bare print at {other}"),
        }
    }

    /// Why there are no colours, and what is not determined.
    pub(crate) fn remarks(&self) -> Vec<String> {
        let no_colours = self.no_colours.iter().map(|reason| format!("no colours: {reason}"));
        let open = (!self.unresolved.is_empty())
            .then(|| format!("not determined by the measurement: {}", self.unresolved.join(", ")));
        no_colours.chain(open).chain(self.of_chart.clone()).collect()
    }
}

impl ReflectanceJson {
    /// Value and interval, with two digits of the error.
    pub(crate) fn texts(&self) -> [String; 2] {
        let digits = (-libm::log10(self.std_error.max(1e-5)).floor()).clamp(2.0, 6.0) as usize + 1;
        let [low, high] = self.interval;
        [format!("{:.digits$}", self.radiance_factor), format!("{low:.digits$}…{high:.digits$}")]
    }
}

impl ColourJson {
    /// sRGB as `#rrggbb`.
    pub(crate) fn hex(&self) -> Option<String> {
        self.srgb.map(|[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}"))
    }
}
