//! Implements `farmctl recipe`: finds the mixture of measured inks whose print comes closest to a colour.

mod search;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_figures::numbers::{minus, significant, with_error};
use farm_lab::colour::{Colorimetry, delta_e_2000};
use farm_lab::document::{Block, ValueTable};
use farm_lab::grid_file::read_text;
use farm_lab::media_file::MediaFile;
use serde::Serialize;

use super::view_args::ViewArgs;
use crate::output::Output;
use crate::prints::bases::PrintBase;
use crate::prints::errors::lab_std_errors;
use crate::prints::view::PrintView;
use farm_lab::slabs::NamedSlab;
use search::{ShareLimits, closest};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl recipe media --target 60,20,-10 --thickness 2
  farmctl recipe media --target 60,20,-10 --target 75,0,30 --thickness 1 --most cyan=0.2
  farmctl recipe media --target wanted.csv --thickness 2 --opacity 0.95

A target is L*,a*,b* where the channels are wavelengths, or a CSV file with the columns
channel and value: radiance factors. Mixtures add by volume.")]
pub(crate) struct RecipeArgs {
    /// Measured inks: media.json, or the folder that contains it.
    media: PathBuf,
    /// Colour to match; it may be repeated.
    #[arg(long, value_name = "LAB|FILE", required = true, allow_hyphen_values = true)]
    target: Vec<String>,
    /// Thickness of the print in mm.
    #[arg(long, value_name = "MM")]
    thickness: f64,
    /// Inks to mix [default: all materials of the media].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    inks: Vec<String>,
    /// Largest share of an ink, as in magenta=0.2; it may be repeated.
    #[arg(long, value_name = "INK=SHARE")]
    most: Vec<String>,
    /// Base under the print.
    #[arg(long, value_name = "BASE", default_value = "white")]
    over: String,
    /// Least contrast ratio: brightness over black over that over white. A hundredth that lacks counts as one unit of
    /// CIEDE2000.
    #[arg(long, value_name = "RATIO")]
    opacity: Option<f64>,
    #[command(flatten)]
    view: ViewArgs,
}

/// A colour to match.
enum ColourTarget {
    Lab([f64; 3]),
    /// Radiance factors by channel.
    Values(Vec<(String, f64)>),
}

#[derive(Debug, Serialize)]
pub(crate) struct RecipeJson {
    thickness_mm: f64,
    /// The least contrast ratio that was asked for.
    opacity: Option<f64>,
    recipes: Vec<FoundRecipe>,
}

#[derive(Debug, Serialize)]
struct FoundRecipe {
    target: String,
    /// Inks with a share of at least a thousandth.
    shares: Vec<RecipeShare>,
    /// CIEDE2000, or the root mean square of relative differences in per cent where channels are no wavelengths.
    difference: f64,
    is_delta_e: bool,
    lab: Option<[f64; 3]>,
    lab_std_errors: Option<[f64; 3]>,
    /// Brightness over black over that over white.
    contrast_ratio: f64,
    radiance_factors: Vec<RecipeValue>,
    /// Inks at the largest share that is allowed.
    limited_by: Vec<String>,
}

#[derive(Debug, Serialize)]
struct RecipeShare {
    ink: String,
    share: f64,
}

#[derive(Debug, Serialize)]
struct RecipeValue {
    channel: String,
    value: f64,
    std_error: f64,
}

pub(crate) fn run(args: &RecipeArgs, output: &Output) -> Result<()> {
    let data = data(args)?;
    output.answer("recipe", &data, || blocks(&data))
}

/// The inks of a request, and how their mixtures look.
struct InkMixer<'a> {
    args: &'a RecipeArgs,
    file: &'a MediaFile,
    names: Vec<String>,
    /// The base, black, and white.
    bases: [PrintBase; 3],
    /// The even mixture of all inks.
    even: PrintView<'a>,
    /// None unless the channels are wavelengths that cover the visible range.
    colorimetry: Option<Colorimetry>,
    /// Places of the channels by rising wavelength.
    order: Vec<usize>,
}

fn data(args: &RecipeArgs) -> Result<RecipeJson> {
    let file = MediaFile::read(&args.media)?;
    optics_model::medium::check_thickness(args.thickness)?;
    if let Some(ratio) = args.opacity.filter(|ratio| !(0.0..=1.0).contains(ratio)) {
        bail!("--opacity {ratio}: allowed are 0 to 1");
    }
    let all = || file.materials.iter().map(|m| m.material.clone()).collect();
    let names: Vec<String> = if args.inks.is_empty() { all() } else { args.inks.clone() };
    if let Some(twice) = (1..names.len()).find(|i| names[..*i].contains(&names[*i])) {
        bail!("--inks: {} may be given once", names[twice]);
    }
    let most = most(&args.most, &names)?;
    let bases = [PrintBase::parsed(&args.over)?, PrintBase::parsed("black")?, PrintBase::parsed("white")?];
    let even = mixture(&names, &vec![1.0; names.len()], args.thickness);
    let even = PrintView::new(&file, &[even], &bases, &args.view.options())?;
    let channels = even.names();
    let viewing = args.view.options().viewing;
    let found = Colorimetry::for_channels(&channels, file.chart.as_ref(), viewing).ok();
    let as_they_are = (0..channels.len()).collect();
    let (colorimetry, order) = found.map_or((None, as_they_are), |(c, order)| (Some(c), order));
    let inks = InkMixer { args, file: &file, names, bases, even, colorimetry, order };
    let recipes = args.target.iter().map(|target| inks.recipe(target, &most)).collect::<Result<_>>()?;
    Ok(RecipeJson { thickness_mm: args.thickness, opacity: args.opacity, recipes })
}

/// The largest share of each ink.
fn most(given: &[String], names: &[String]) -> Result<Vec<f64>> {
    let mut most = vec![1.0; names.len()];
    for text in given {
        let parsed = text.rsplit_once('=').and_then(|(name, share)| Some((name, share.parse::<f64>().ok()?)));
        let (name, share) = parsed.filter(|(_, share)| (0.0..=1.0).contains(share)).with_context(|| {
            format!("--most {text}: an ink and its largest share from 0 to 1 are needed, as in magenta=0.2")
        })?;
        let at = names.iter().position(|n| n == name);
        most[at.with_context(|| format!("--most {text}: the inks are {}", names.join(", ")))?] = share;
    }
    if most.iter().sum::<f64>() < 1.0 - 1e-9 {
        bail!("--most leaves {} of the volume at most: it must allow all of it", most.iter().sum::<f64>());
    }
    Ok(most)
}

/// A slab of inks whose shares are in these proportions.
fn mixture(names: &[String], shares: &[f64], thickness_mm: f64) -> NamedSlab {
    let sum: f64 = shares.iter().sum();
    let parts = names.iter().cloned().zip(shares.iter().map(|share| share / sum));
    NamedSlab { shares: parts.filter(|(_, share)| *share > 0.0).collect(), thickness_mm }
}

impl ColourTarget {
    fn parsed(text: &str) -> Result<Self> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        if let Some(lab) = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok()) {
            let within = |v: &f64, most: f64| (-most..=most).contains(v);
            if !((0.0..=100.0).contains(&lab[0]) && lab[1..].iter().all(|v| within(v, 200.0))) {
                bail!("target {text}: allowed are L* from 0 to 100, a* and b* from -200 to 200");
            }
            return Ok(Self::Lab(lab));
        }
        let place = || format!("target {text}: it is neither L*,a*,b* nor a file with channel,value");
        let table = read_text(Path::new(text), "target").with_context(place)?;
        let mut reader = csv::Reader::from_reader(table.as_bytes());
        let row = |row: Result<(String, f64), csv::Error>| row.with_context(place);
        Ok(Self::Values(reader.deserialize().map(row).collect::<Result<_>>()?))
    }
}

impl InkMixer<'_> {
    fn recipe(&self, text: &str, most: &[f64]) -> Result<FoundRecipe> {
        let target = ColourTarget::parsed(text)?;
        if matches!(target, ColourTarget::Lab(_)) && self.colorimetry.is_none() {
            bail!(
                "target {text}: L*,a*,b* need channels that are wavelengths of the visible range; give a file of channel,value"
            );
        }
        // Index and roughness are those of the mixture that is found.
        let near = self.slab(&self.closest(&self.even, &target, most)?);
        let view = PrintView::new(self.file, &[near], &self.bases, &self.args.view.options())?;
        let shares = self.closest(&view, &target, most)?;
        self.answer(&view, text, &target, &shares, most)
    }

    fn closest(&self, view: &PrintView, target: &ColourTarget, most: &[f64]) -> Result<Vec<f64>> {
        let cost = |shares: &[f64]| -> Result<f64> {
            let found = view.values(&[self.slab(shares)])?;
            let difference = self.difference(target, &found)?;
            let opacity =
                self.args.opacity.map_or(0.0, |ratio| 100.0 * (ratio - self.contrast_ratio(&found)).max(0.0));
            Ok(libm::hypot(difference, opacity))
        };
        closest(&ShareLimits { most }, cost)
    }

    fn slab(&self, shares: &[f64]) -> NamedSlab {
        mixture(&self.names, shares, self.args.thickness)
    }

    fn answer(
        &self,
        view: &PrintView,
        text: &str,
        target: &ColourTarget,
        shares: &[f64],
        most: &[f64],
    ) -> Result<FoundRecipe> {
        const SMALLEST: f64 = 1e-3;
        let slab = self.slab(shares);
        let predicted = view.predicted(std::slice::from_ref(&slab))?;
        let found: Vec<Vec<f64>> = predicted.iter().map(|of| of.iter().map(|p| p.value).collect()).collect();
        let lab = self.lab(&found);
        let value = |(name, of): (&&str, &Vec<optics_layers::Predicted>)| RecipeValue {
            channel: (*name).to_owned(),
            value: of[0].value,
            std_error: of[0].std_error(),
        };
        let limited = |i: &usize| most[*i] < 1.0 && shares[*i] > most[*i] - SMALLEST;
        let kept = slab.shares.iter().filter(|(_, share)| *share >= SMALLEST);
        Ok(FoundRecipe {
            target: text.to_owned(),
            shares: kept.map(|(ink, share)| RecipeShare { ink: ink.clone(), share: *share }).collect(),
            difference: self.difference(target, &found)?,
            is_delta_e: lab.is_some(),
            lab,
            lab_std_errors: self.colorimetry.as_ref().map(|c| lab_std_errors(c, &predicted, &self.order, 0)),
            contrast_ratio: self.contrast_ratio(&found),
            radiance_factors: self.even.names().iter().zip(&predicted).map(value).collect(),
            limited_by: (0..shares.len()).filter(limited).map(|i| self.names[i].clone()).collect(),
        })
    }

    fn lab(&self, found: &[Vec<f64>]) -> Option<[f64; 3]> {
        let spectrum: Vec<f64> = self.order.iter().map(|i| found[*i][0]).collect();
        self.colorimetry.as_ref().map(|c| c.colour(&spectrum).lab)
    }

    /// CIEDE2000, or per cent.
    fn difference(&self, target: &ColourTarget, found: &[Vec<f64>]) -> Result<f64> {
        let values = match target {
            ColourTarget::Lab(lab) => {
                return Ok(self.lab(found).map_or(f64::INFINITY, |found| delta_e_2000(*lab, found)));
            }
            ColourTarget::Values(values) => values,
        };
        let target_value = |name: &&str| {
            let found = values.iter().find(|(channel, _)| channel == name).map(|(_, value)| *value);
            found
                .filter(|v| *v > 0.0)
                .with_context(|| format!("the target has no value above 0 for channel {name}"))
        };
        let wanted: Vec<f64> = self.even.names().iter().map(target_value).collect::<Result<_>>()?;
        if let Some(colorimetry) = &self.colorimetry {
            let ordered: Vec<f64> = self.order.iter().map(|i| wanted[*i]).collect();
            let lab = colorimetry.colour(&ordered).lab;
            return Ok(self.lab(found).map_or(f64::INFINITY, |found| delta_e_2000(lab, found)));
        }
        let squares: f64 = wanted.iter().zip(found).map(|(w, f)| (100.0 * libm::log(f[0] / w)).powi(2)).sum();
        Ok((squares / wanted.len() as f64).sqrt())
    }

    /// The ratio of luminances, or of the means of all channels.
    fn contrast_ratio(&self, found: &[Vec<f64>]) -> f64 {
        let brightness = |base: usize| {
            let spectrum: Vec<f64> = self.order.iter().map(|i| found[*i][base]).collect();
            let mean = || spectrum.iter().sum::<f64>() / spectrum.len() as f64;
            self.colorimetry.as_ref().map_or_else(mean, |c| c.xyz(&spectrum)[1])
        };
        brightness(1) / brightness(2)
    }
}

/// Differences up to which a colour counts as reached.
const REACHED: f64 = 1.0;

fn blocks(data: &RecipeJson) -> Vec<Block> {
    let row = |r: &FoundRecipe| {
        let parts = r.shares.iter().map(|s| format!("{} % {}", significant(100.0 * s.share, 3), s.ink));
        let lab = r.lab.zip(r.lab_std_errors).map_or_else(
            || "–".to_owned(),
            |(lab, errors)| (0..3).map(|k| with_error(lab[k], errors[k])).collect::<Vec<_>>().join("\n"),
        );
        let unit = if r.is_delta_e { "" } else { " %" };
        let difference = format!("{}{unit}", significant(r.difference, 2));
        vec![
            minus(&r.target),
            parts.collect::<Vec<_>>().join("\n"),
            lab,
            difference,
            significant(r.contrast_ratio, 3),
        ]
    };
    let mut blocks = vec![
        Block::Heading(3, format!("mixtures by volume, {} mm", data.thickness_mm)),
        ValueTable::new("target | recipe | L*  a*  b* | >ΔE₀₀ | >Y/Y", data.recipes.iter().map(row)).block(),
    ];
    for r in &data.recipes {
        let limits = match (&r.limited_by[..], data.opacity) {
            ([], None) => "the inks do not reach it: another ink, or another thickness, is needed".to_owned(),
            ([], Some(_)) => "the inks do not reach it, or not with this opacity".to_owned(),
            (inks, _) => format!("limited by --most of {}", inks.join(", ")),
        };
        let target = minus(&r.target);
        if let Some(ratio) = data.opacity.filter(|ratio| r.contrast_ratio < ratio - 0.005) {
            let found = significant(r.contrast_ratio, 3);
            blocks.push(Block::Paragraph(format!("{target}: contrast ratio {found} instead of {ratio}")));
        }
        if r.difference > REACHED {
            let off = significant(r.difference, 2);
            blocks.push(Block::Paragraph(format!("{target}: off by {off}: {limits}")));
        }
    }
    blocks
}
