//! The statement of uncertainty of measured media, in the words of the GUM (JCGM 100:2008): measurands, input quantities,
//! standard and expanded uncertainties, their budget and correlations, and traceability.

mod evaluation;
mod inputs;

use farm_figures::numbers::{fixed, significant, to_error, with_error};
use optics_model::fit::{Common, MaterialFit, SharedErrors};

use crate::document::{Block, Document, Remark, ValueTable};
use crate::record::SessionRecord;
use evaluation::{EvaluatedChannel, MEASURANDS, evaluated};
use inputs::input_rows;

/// Name of the page in the folder of a session or of media.
pub const UNCERTAINTY_FILE: &str = "uncertainty.html";

/// The contents of a statement of uncertainty.
#[derive(Debug, Clone, Copy)]
pub struct UncertaintyStatement<'a> {
    pub fits: &'a [MaterialFit],
    pub shared_errors: &'a SharedErrors,
    pub common: &'a Common,
    /// None if the profiles are not those of `farmctl capture`.
    pub record: Option<&'a SessionRecord>,
    pub dictionary: &'a str,
    /// Digest of the dictionary's grid and physics.
    pub digest: &'a str,
}

const MODEL: [&str; 2] = [
    "Of each material in each channel, of the light that the channel passes: the extinction coefficient σ_t, the reduced \
     scattering coefficient σ_s(1 − g) and the absorption coefficient σ_a, per mm, of a homogeneous, isotropic material \
     without fluorescence.",
    "The estimates maximise the likelihood of all photographs of the session together: the measured profiles across a \
     black–white edge are those of a Monte Carlo simulation of the stack, transformed by the input quantities below. Input \
     quantities other than noise have normal priors with the stated standard uncertainties (those of the scene have wider \
     tails beyond two of them) and are estimated with the measurands, so their correlations are included (GUM 5.2). Gain, \
     zero and slope of a slab have a correlation of ½ between channels. Combined standard uncertainties u_c follow from \
     the inverse of the information at the maximum, times the factor by which residuals exceed their noise where that is \
     unlikely to be chance. The interval of 95 % is that of the profile likelihood, which need not be symmetric; k u_c is \
     stated for comparison.",
];

const BUDGET: &str = "Contributions |c_i| u(x_i) in per cent of the value, whose squares add up to u_c². “g” is the growth of \
     u_c because the anisotropy is estimated, too; “other channels” are errors of other materials and channels through \
     what they share.";

const NOT_COVERED: [&str; 5] = [
    "Fluorescence: light that is absorbed and sent out at other wavelengths.",
    "Variation within a material, between batches, with age, curing or temperature: the values are those of these slabs.",
    "Polarisation, and materials whose scattering depends on the direction.",
    "Phase functions that two Henyey–Greenstein lobes do not describe.",
    "Errors of a set-up beyond its stated uncertainties.",
];

impl UncertaintyStatement<'_> {
    pub fn document(&self) -> Document {
        let channels = evaluated(self.fits, self.shared_errors);
        let Common { mu, mu_std_error, .. } = self.common;
        let names: Vec<&str> = self.fits.iter().map(|fit| fit.material.as_str()).collect();
        let materials = ("Materials".to_owned(), names.join(", "));
        let mut blocks = vec![
            Block::paragraph(
                "Optical parameters of translucent materials, stated after JCGM 100:2008 (GUM).",
            ),
            Block::Entries(std::iter::once(materials).chain(self.entries(false)).collect()),
            Block::heading(2, "Measurands and model"),
        ];
        blocks.extend(MODEL.map(Block::paragraph));
        blocks.extend([
            Block::heading(2, "Traceability"),
            Block::Entries(self.entries(true)),
            Block::paragraph(self.traceability()),
            Block::heading(2, "Results"),
            Block::paragraph("All values in 1/mm."),
            Block::Remarks(doubts(&channels)),
            results(&channels),
            Block::heading(2, "Input quantities"),
            ValueTable::new(inputs::HEAD, input_rows(self.fits, self.record.is_some())).block(),
            Block::heading(2, "Budget"),
            Block::paragraph(BUDGET),
        ]);
        blocks.extend((0..MEASURANDS.len()).flat_map(|i| budget(&channels, i)));
        blocks.push(Block::heading(2, "Correlations"));
        blocks.extend((0..MEASURANDS.len()).flat_map(|i| correlations(&channels, i)));
        blocks.extend([
            Block::aside("media.json has the covariances within and between all channels."),
            Block::heading(2, "Not covered"),
            Block::List(NOT_COVERED.map(str::to_owned).to_vec()),
            Block::heading(2, "Evaluation"),
            Block::paragraph(format!(
                "farmctl {}, dictionary {} ({}). Scale factor of the measured values μ = {}.",
                env!("CARGO_PKG_VERSION"),
                self.dictionary,
                self.digest,
                with_error(*mu, *mu_std_error),
            )),
            Block::SignOff(["Measured by", "Approved by"].map(str::to_owned).to_vec()),
        ]);
        Document { title: "Uncertainty of measurement".to_owned(), blocks }
    }

    /// Labels and texts of the session's record: its certificates, or all else.
    fn entries(&self, certificates: bool) -> Vec<(String, String)> {
        let all = self.record.map(SessionRecord::entries).unwrap_or_default().into_iter();
        let some = all.filter(|(key, ..)| key.ends_with("_certificate") == certificates);
        some.map(|(_, label, text)| (label.to_owned(), text.to_owned())).collect()
    }

    fn traceability(&self) -> String {
        let none = SessionRecord::default();
        let record = self.record.unwrap_or(&none);
        let lacking: Vec<&str> = [
            (&record.white_certificate, "the white reference"),
            (&record.thickness_certificate, "the thickness of the slabs"),
            (&record.scale_certificate, "the board's squares"),
        ]
        .into_iter()
        .filter_map(|(certificate, name)| certificate.is_none().then_some(name))
        .collect();
        let names = match &lacking[..] {
            [] => return "Lengths and reflectances are traceable through these certificates.".to_owned(),
            [one] => (*one).to_owned(),
            [first @ .., last] => format!("{} and {last}", first.join(", ")),
        };
        format!(
            "No certificate is stated for {names}: traceability to the SI is not claimed for what depends on them."
        )
    }
}

fn results(channels: &[EvaluatedChannel]) -> Block {
    let head = "material | channel | measurand | >value | >u_c | >k | >k u_c | >interval of 95 % | >ν_eff";
    let row = |channel: &EvaluatedChannel, i: usize| {
        let m = &channel.measurands[i];
        let [value, u] = m
            .std_uncertainty
            .map_or_else(|| [significant(m.value, 4), "–".to_owned()], |u| to_error(m.value, u, 2));
        vec![
            channel.material.to_owned(),
            channel.channel.to_owned(),
            MEASURANDS[i].to_owned(),
            value,
            u,
            significant(m.coverage_factor, 3),
            m.std_uncertainty.map_or_else(|| "–".to_owned(), |u| significant(m.coverage_factor * u, 2)),
            m.interval.clone(),
            m.degrees_of_freedom.map_or_else(|| "∞".to_owned(), |nu| format!("{nu:.0}")),
        ]
    };
    let rows = channels.iter().flat_map(|channel| (0..MEASURANDS.len()).map(|i| row(channel, i)));
    ValueTable::new(head, rows).block()
}

/// Warnings that precede the values.
fn doubts(channels: &[EvaluatedChannel]) -> Vec<Remark> {
    let worst = channels.iter().filter(|c| c.is_enlarged()).map(|c| c.refined.misfit).fold(0.0, f64::max);
    let enlarged = format!(
        "residuals exceed what noise and the input quantities explain (up to {} times); u_c contains this factor, but its \
         cause may have shifted the values",
        significant(worst, 2)
    );
    let remark = |is_doubtful: &dyn Fn(&EvaluatedChannel) -> bool, text: &str| {
        let about = channels.iter().filter(|c| is_doubtful(c)).map(EvaluatedChannel::label).collect();
        Remark { about, text: text.to_owned(), warning: true }
    };
    let all = [
        remark(&|c| !c.refined.resolved, "the data do not determine σ_t and the albedo separately"),
        remark(&|c| c.is_enlarged(), &enlarged),
        remark(
            &|c| c.refined.from_mixtures,
            "values follow from mixtures: budget and correlations are not stated",
        ),
    ];
    all.into_iter().filter(|remark| !remark.about.is_empty()).collect()
}

/// Channels that one table of the budget has at most: more do not fit on a page.
const MOST_COLUMNS: usize = 6;

/// Contributions below this share of the value in per cent get no row.
const LEAST_SHOWN: f64 = 0.05;

/// Contributions to a measurand's u_c in per cent of the value, with a row for each source and a column for each channel.
fn budget(channels: &[EvaluatedChannel], measurand: usize) -> Vec<Block> {
    let mut names: Vec<&str> = Vec::new();
    for (name, part) in channels.iter().flat_map(|c| &c.measurands[measurand].contributions) {
        if *part >= LEAST_SHOWN && !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let part = |channel: &EvaluatedChannel, name: &str| {
        let found = channel.measurands[measurand].contributions.iter().find(|(other, _)| other == name);
        significant(found.map_or(0.0, |(_, part)| *part), 2)
    };
    let combined = |channel: &EvaluatedChannel| {
        let m = &channel.measurands[measurand];
        let percent = |u: f64| significant(100.0 * u / m.value.max(f64::MIN_POSITIVE), 2);
        m.std_uncertainty.map_or_else(|| "–".to_owned(), percent)
    };
    let table = |some: &[EvaluatedChannel]| {
        let source = |name: &&str| {
            std::iter::once((*name).to_owned()).chain(some.iter().map(|c| part(c, name))).collect()
        };
        let last = std::iter::once("u_c".to_owned()).chain(some.iter().map(combined)).collect();
        let rows = names.iter().map(source).chain([last]);
        ValueTable::of_numbers("source", some.iter().map(EvaluatedChannel::label), rows).block()
    };
    let tables = channels.chunks(MOST_COLUMNS).map(table);
    std::iter::once(Block::heading(3, MEASURANDS[measurand])).chain(tables).collect()
}

/// The matrix of a measurand's correlations, or their ranges where channels are many.
fn correlations(channels: &[EvaluatedChannel], measurand: usize) -> Vec<Block> {
    /// Most channels of a matrix on a page.
    const MOST: usize = 12;
    if channels.len() > MOST {
        return vec![Block::paragraph(spread(channels, measurand))];
    }
    let labels = channels.iter().map(EvaluatedChannel::label);
    let row = |a: &EvaluatedChannel| {
        let cells = channels.iter().map(|b| fixed(a.correlation(b, measurand), 2));
        std::iter::once(a.label()).chain(cells).collect()
    };
    let matrix = ValueTable::of_numbers("", labels, channels.iter().map(row)).block();
    vec![Block::heading(3, MEASURANDS[measurand]), matrix]
}

/// The range of correlations between channels of one material, and between those of two.
fn spread(channels: &[EvaluatedChannel], measurand: usize) -> String {
    let mut all: [Vec<f64>; 2] = Default::default();
    for (i, a) in channels.iter().enumerate() {
        for b in &channels[..i] {
            all[usize::from(a.material != b.material)].push(a.correlation(b, measurand));
        }
    }
    let text = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let Some((first, last)) = values.first().zip(values.last()) else { return "–".to_owned() };
        let [first, last, median] = [*first, *last, values[values.len() / 2]].map(|v| fixed(v, 2));
        format!("{first} to {last}, median {median}")
    };
    let [same, other] = all.map(text);
    format!("{}: {same} within a material, {other} between materials", MEASURANDS[measurand])
}

#[cfg(test)]
mod tests;
