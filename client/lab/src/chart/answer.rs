//! The answer about a chart: media, how well they predict patches that were held out, and what is wrong with the chart.

use anyhow::{Context, Result};
use farm_figures::numbers::{interval, significant, to_error};
use optics_chart::{ChartFit, fit};
use optics_model::fit::{Interval, MaterialFit, Refined};

use super::data::{ChartBase, ChartJson, ChartLight, ChartNumber};
use super::file::ChartFile;
use super::judged::{JudgedChart, judged};
use super::media;
use super::notes::{layers_mm, notes};
use super::patch::NamedPatch;
use super::problem::{NamedChart, downwards};
use crate::document::{Block, Remark, ValueTable};
use crate::media_file::{MediaChart, MediaFile};

/// Largest number of warnings on the first screen.
const WARNINGS: usize = 5;

/// A chart's answer.
#[derive(Debug)]
pub struct ChartAnswer {
    pub data: ChartJson,
    pub fits: Vec<MaterialFit>,
    pub media: MediaFile,
    fitted: JudgedChart,
    /// Values of each patch by the other patches.
    expected: Vec<Vec<f64>>,
}

/// The media of a chart.
pub fn measured(file: &ChartFile) -> Result<ChartAnswer> {
    let named = NamedChart::new(file, downwards)?;
    let undetermined = "the chart determines no media: is every material in several stacks?";
    let found = fit(&named.chart).context(undetermined)?;
    let few = found.held_out.is_empty();
    let values = file.patches.len() * file.channels.len();
    let free = 2 * file.channels.len() * named.materials.len();
    let ratio = found.chi2 / values.saturating_sub(free).max(1) as f64;
    // Where the errors of values are those of the table, they may be too small.
    let misfit = if few && !file.is_colour { ratio.sqrt() } else { 1.0 };
    let (fits, errors) = media::fits(&named, file, &found, misfit);
    let held_out = if few { None } else { judged(&file.patches, &found.held_out, file.is_colour) };
    let fitted = judged(&file.patches, &found.fitted, file.is_colour).context("a chart has patches")?;
    let number = |place: usize| ChartNumber {
        value: found.at[place],
        std_error: found.covariance[(place, place)].max(0.0).sqrt(),
    };
    let [ior, ior_error] = media::index(&named, &found);
    let rows = |i: usize| found.model_error.row(i).iter().copied().collect::<Vec<f64>>();
    let model_error: Vec<Vec<f64>> =
        if few && !file.is_colour { Vec::new() } else { (0..found.model_error.nrows()).map(rows).collect() };
    let base = |(base, name): (usize, &String)| {
        let rho = |(channel, of): (usize, &String)| {
            let place = found.unknowns.base(base, channel)?;
            Some(ChartBase { base: name.clone(), channel: of.clone(), rho: number(place) })
        };
        file.channels.iter().enumerate().filter_map(rho).collect::<Vec<_>>()
    };
    let mut data = ChartJson {
        patches: file.patches.len(),
        materials: fits.clone(),
        chi2: found.chi2,
        values,
        matrix: found.unknowns.matrix(&named.chart, &found.at),
        sheen: number(found.unknowns.sheen),
        sample_ior: ChartNumber { value: ior, std_error: ior_error },
        bases: named.bases.iter().enumerate().flat_map(base).collect(),
        light: lights(&named, &found),
        model_error,
        descent: found.end,
        held_out,
        notes: file.notes.clone(),
    };
    data.notes.extend(notes(file, &named, &data, misfit)?);
    let chart = MediaChart {
        matrix: data.matrix.filter(|_| file.is_colour),
        sheen: if named.chart.views.iter().any(|view| view.has_sheen) { data.sheen.value } else { 0.0 },
        model_error: data.model_error.clone(),
        delta_e_2000_below: data.held_out.as_ref().filter(|_| file.is_colour).map(|h| h.below_95),
        layers_mm: layers_mm(file),
    };
    let digested = format!("{:?}", file.patches);
    let media = media::media_file(&named, file, &found, (&fits, &errors), chart, digested.as_bytes())?;
    let expected = if few { found.fitted } else { found.held_out };
    Ok(ChartAnswer { data, fits, media, fitted, expected })
}

/// Root mean squares by channel of the differences of cube roots, which are about as large for dark and for bright patches.
fn root_errors(file: &ChartFile, expected: &[Vec<f64>]) -> Vec<f64> {
    let square = |channel: usize| {
        let difference =
            |(p, e): (&NamedPatch, &Vec<f64>)| libm::cbrt(p.values[channel]) - libm::cbrt(e[channel]);
        let sum: f64 = file.patches.iter().zip(expected).map(difference).map(|v| v * v).sum();
        (sum / file.patches.len() as f64).sqrt()
    };
    (0..file.channels.len()).map(square).collect()
}

fn lights(named: &NamedChart, found: &ChartFit) -> Vec<ChartLight> {
    let range = |(photo, name): (usize, &String)| {
        let own = named.chart.patches.iter().filter_map(|p| p.place.filter(|(of, _)| *of == photo));
        let light: Vec<f64> = own.map(|place| found.light(&named.chart, place)).collect();
        let (low, high) = light.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), v| (a.min(*v), b.max(*v)));
        let mean = light.iter().sum::<f64>() / light.len().max(1) as f64;
        ChartLight { photo: name.clone(), range: (high - low) / mean }
    };
    if !named.chart.light {
        return Vec::new();
    }
    named.photos.iter().enumerate().map(range).collect()
}

impl ChartAnswer {
    /// Measured value, prediction from other patches, and its standard error, of all patches and channels.
    pub fn predictions<'a>(&'a self, file: &'a ChartFile) -> impl Iterator<Item = (f64, f64, f64)> + 'a {
        let errors = root_errors(file, &self.expected);
        file.patches.iter().zip(&self.expected).flat_map(move |(patch, expected)| {
            let point = |c: usize| {
                let root = libm::cbrt(expected[c].max(1e-3));
                (patch.values[c], expected[c], 3.0 * root * root * errors[c])
            };
            (0..errors.len()).map(point).collect::<Vec<_>>()
        })
    }

    /// The answer: its first screen, or all of it.
    pub fn blocks(&self, whole: bool) -> Vec<Block> {
        let mut blocks = vec![Block::Verdict(self.verdict()), self.table()];
        blocks.push(Block::Aside(
            "± are 95 %; a chart does not determine g: σ_t follows from σ_s(1 − g) and the g that is given"
                .to_owned(),
        ));
        let remarks: Vec<Remark> =
            self.data.notes.iter().map(|note| Remark::warning(note.text.clone())).collect();
        let left = if whole { 0 } else { remarks.len().saturating_sub(WARNINGS) };
        let shown = remarks.len() - left;
        blocks.push(Block::Remarks(remarks.into_iter().take(shown).collect()));
        if left > 0 {
            blocks.push(Block::paragraph(format!("and {left} more: -v")));
        }
        if whole {
            blocks.extend(self.details());
        }
        blocks
    }

    fn verdict(&self) -> String {
        let names: Vec<&str> = self.fits.iter().map(|fit| fit.material.as_str()).collect();
        let judged = self.data.held_out.as_ref();
        let unit = |of: &JudgedChart, v: f64| match of.unit {
            "CIEDE2000" => format!("CIEDE2000 {}", significant(v, 3)),
            _ => format!("{} %", significant(100.0 * v, 2)),
        };
        let found = format!("Media of {} from {} patches.", names.join(", "), self.data.patches);
        if let Some(held_out) = judged {
            return format!(
                "{found} Patches that were held out are predicted to {} in the median, 95 % of them below {}.",
                unit(held_out, held_out.median),
                unit(held_out, held_out.below_95).trim_start_matches("CIEDE2000 ")
            );
        }
        let median = unit(&self.fitted, self.fitted.median);
        format!("{found} They are met to {median} in the median; too few were measured to hold some out.")
    }

    fn table(&self) -> Block {
        let row = |(fit, c): (&MaterialFit, &optics_model::fit::ChannelFit)| {
            let mut row = vec![fit.material.clone(), c.channel.clone()];
            if let Some(r) = &c.refined {
                row.extend([cell(reduced_scattering(r), &r.reduced_scattering_per_mm)]);
                row.extend([cell(r.best.medium.absorption_per_mm(), &r.absorption_per_mm)]);
            }
            row
        };
        let rows = self.fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c))).map(row);
        ValueTable::new("material | ch | >σ_s(1−g)\n/mm | >σ_a\n/mm", rows).block()
    }

    fn details(&self) -> Vec<Block> {
        let data = &self.data;
        let mut entries = vec![
            ("sheen".to_owned(), with_error(data.sheen)),
            ("index".to_owned(), with_error(data.sample_ior)),
        ];
        entries.extend(data.bases.iter().map(|b| (format!("{} {}", b.base, b.channel), with_error(b.rho))));
        entries.extend(data.matrix.map(|matrix| {
            let row = |row: [f64; 3]| row.map(|v| format!("{v:.3}")).join(" ");
            ("matrix of the camera".to_owned(), matrix.map(row).join("; "))
        }));
        entries.extend(data.light.iter().map(|light| {
            (
                format!("light of photograph {}", light.photo),
                format!("varies by {} %", significant(100.0 * light.range, 2)),
            )
        }));
        let mut blocks = vec![Block::heading(2, "Set-up"), Block::Entries(entries)];
        let judged = data.held_out.as_ref().unwrap_or(&self.fitted);
        blocks.extend(judged_blocks(judged));
        blocks
    }
}

/// Groups and worst patches.
pub fn judged_blocks(judged: &JudgedChart) -> [Block; 4] {
    let digits = |v: f64| significant(v, 3);
    let group =
        |g: &super::judged::JudgedGroup| vec![g.group.clone(), g.patches.to_string(), digits(g.median)];
    let patch = |p: &super::judged::JudgedPatch| {
        let numbers = |v: &[f64]| v.iter().take(3).map(|v| significant(*v, 3)).collect::<Vec<_>>().join(" ");
        vec![
            p.patch.clone(),
            p.slabs.clone(),
            numbers(&p.measured),
            numbers(&p.expected),
            digits(p.difference),
        ]
    };
    [
        Block::heading(2, &format!("Differences ({})", judged.unit)),
        ValueTable::new("stacks | >patches | >median", judged.by_top.iter().map(group)).block(),
        Block::heading(2, "The worst patches"),
        ValueTable::new("patch | slabs | measured | expected | >difference", judged.worst.iter().map(patch))
            .block(),
    ]
}

fn reduced_scattering(r: &Refined) -> f64 {
    r.best.medium.reduced_scattering_per_mm()
}

/// `3.58 ± 0.11`, or the interval where it is open or wide.
fn cell(value: f64, ends: &Interval) -> String {
    let half = 0.5 * (ends.high - ends.low);
    if ends.open_low || ends.open_high || half > 0.5 * value {
        return interval(ends, |end| significant(end, 2));
    }
    to_error(value, half, 2).join(" ± ")
}

fn with_error(number: ChartNumber) -> String {
    to_error(number.value, number.std_error, 2).join(" ± ")
}
