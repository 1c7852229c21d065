//! Renders the statement of uncertainty of measured media, in the words of the GUM (JCGM 100:2008): measurands, input
//! quantities, standard and expanded uncertainties, their budget and correlations, and traceability.

mod evaluation;
mod inputs;

use farm_figures::numbers::{minus, significant, with_error};
use optics_model::fit::{Common, MaterialFit, SharedErrors};

use crate::page::{escaped, page, table};
use crate::record::SessionRecord;
use evaluation::{EvaluatedChannel, MEASURANDS, evaluated};
use inputs::{InputQuantity, input_quantities};

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

impl UncertaintyStatement<'_> {
    pub fn page(&self) -> String {
        let channels = evaluated(self.fits, self.shared_errors);
        let body = [
            self.head(),
            measurands(),
            self.traceability(),
            results(&channels),
            input_table(&input_quantities(self.fits, self.record.is_some())),
            budgets(&channels),
            correlations(&channels),
            limits(),
            self.software(),
        ];
        page("Uncertainty of measurement", &body.concat())
    }

    fn entries(&self) -> Vec<(&'static str, &'static str, &str)> {
        self.record.map(SessionRecord::entries).unwrap_or_default()
    }

    fn head(&self) -> String {
        let names: Vec<&str> = self.fits.iter().map(|fit| fit.material.as_str()).collect();
        let row = |(_, label, text): (_, &str, &str)| vec![label.to_owned(), text.to_owned()];
        let mut rows = vec![vec!["Materials".to_owned(), names.join(", ")]];
        rows.extend(self.entries().into_iter().filter(|(key, ..)| !is_certificate(key)).map(row));
        format!(
            "<h1>Uncertainty of measurement</h1>\n<p>Optical parameters of translucent materials, stated after JCGM \
             100:2008 (GUM).</p>\n{}",
            table("text", &[], &rows)
        )
    }

    fn traceability(&self) -> String {
        let certificates = self.entries();
        let row = |(_, label, text): &(_, &str, &str)| vec![(*label).to_owned(), (*text).to_owned()];
        let rows: Vec<Vec<String>> =
            certificates.iter().filter(|(key, ..)| is_certificate(key)).map(row).collect();
        let is_stated = |key: &str| certificates.iter().any(|(known, ..)| *known == key);
        let lacking: Vec<&str> = [
            ("white_certificate", "the white reference"),
            ("thickness_certificate", "the thickness of the slabs"),
            ("scale_certificate", "the board's squares"),
        ]
        .into_iter()
        .filter(|(key, _)| !is_stated(key))
        .map(|(_, name)| name)
        .collect();
        let statement = if lacking.is_empty() {
            "Lengths and reflectances are traceable through these certificates.".to_owned()
        } else {
            format!(
                "No certificate is stated for {}: traceability to the SI is not claimed for what depends on them.",
                listed(&lacking)
            )
        };
        let rows = if rows.is_empty() { String::new() } else { table("text", &[], &rows) };
        format!("<h2>Traceability</h2>\n{rows}<p>{statement}</p>\n")
    }

    fn software(&self) -> String {
        let Common { mu, mu_std_error, .. } = self.common;
        format!(
            "<h2>Evaluation</h2>\n<p>farmctl {}, dictionary {} ({}). Scale factor of the measured values μ = {}.</p>\n\
             <table class=\"text\"><tr><td>Measured by</td><td class=\"sign\"></td></tr>\
             <tr><td>Approved by</td><td class=\"sign\"></td></tr></table>\n",
            env!("CARGO_PKG_VERSION"),
            escaped(self.dictionary),
            self.digest,
            with_error(*mu, *mu_std_error),
        )
    }
}

/// `a, b and c`.
fn listed(names: &[&str]) -> String {
    match names {
        [first @ .., last] if !first.is_empty() => format!("{} and {last}", first.join(", ")),
        _ => names.concat(),
    }
}

fn is_certificate(key: &str) -> bool {
    key.ends_with("_certificate")
}

fn measurands() -> String {
    "<h2>Measurands and model</h2>\n<p>Of each material in each channel, of the light that the channel passes: the \
     extinction coefficient σ<sub>t</sub>, the reduced scattering coefficient σ<sub>s</sub>(1 − g) and the absorption \
     coefficient σ<sub>a</sub>, per mm, of a homogeneous, isotropic material without fluorescence.</p>\n\
     <p>The estimates maximise the likelihood of all photographs of the session together: the measured profiles across \
     a black–white edge are those of a Monte Carlo simulation of the stack, transformed by the input quantities below. \
     Input quantities other than noise have normal priors with the stated standard uncertainties (those of the scene have wider \
     tails beyond two of them) and are estimated with the measurands, so their correlations are included (GUM 5.2). Gain, \
     zero and slope of a slab have a correlation of ½ between channels. \
     Combined standard uncertainties u<sub>c</sub> follow from the inverse of the information at the maximum, times the \
     factor by which residuals exceed their noise where that is unlikely to be chance. The interval of 95 % is that of the \
     profile likelihood, which need not be symmetric; k u<sub>c</sub> is stated for comparison.</p>\n"
        .to_owned()
}

fn results(channels: &[EvaluatedChannel]) -> String {
    let head =
        ["material", "channel", "measurand", "value", "u_c", "k", "k u_c", "interval of 95 %", "ν_eff"];
    let row = |channel: &EvaluatedChannel, i: usize| {
        let m = &channel.measurands[i];
        let number =
            |factor: f64| m.std_uncertainty.map_or_else(|| "–".to_owned(), |u| significant(factor * u, 2));
        vec![
            channel.material.clone(),
            channel.channel.clone(),
            MEASURANDS[i].to_owned(),
            significant(m.value, 4),
            number(1.0),
            significant(m.coverage_factor, 3),
            number(m.coverage_factor),
            m.interval.clone(),
            m.degrees_of_freedom.map_or_else(|| "∞".to_owned(), |nu| format!("{nu:.0}")),
        ]
    };
    let rows: Vec<Vec<String>> =
        channels.iter().flat_map(|channel| (0..MEASURANDS.len()).map(|i| row(channel, i))).collect();
    format!("<h2>Results</h2>\n<p>All values in 1/mm.</p>\n{}{}", doubts(channels), table("", &head, &rows))
}

/// Warnings that precede the values.
fn doubts(channels: &[EvaluatedChannel]) -> String {
    let labels = |is: &dyn Fn(&EvaluatedChannel) -> bool| {
        channels.iter().filter(|c| is(c)).map(EvaluatedChannel::label).collect::<Vec<_>>().join(", ")
    };
    let worst = channels.iter().filter(|c| c.is_enlarged).map(|c| c.misfit).fold(0.0, f64::max);
    let all = [
        (labels(&|c| !c.is_resolved), "The data do not determine σ_t and the albedo separately".to_owned()),
        (
            labels(&|c| c.is_enlarged),
            format!(
                "Residuals exceed what noise and the input quantities explain (up to {} times); u_c contains this factor, \
                 but its cause may have shifted the values",
                significant(worst, 2)
            ),
        ),
        (
            labels(&|c| c.is_from_mixtures),
            "Values follow from mixtures: budget and correlations are not stated".to_owned(),
        ),
    ];
    let items = all.iter().filter(|(names, _)| !names.is_empty());
    let items: String =
        items.map(|(names, text)| format!("<li>{}: {}.</li>", escaped(text), escaped(names))).collect();
    if items.is_empty() { items } else { format!("<ul class=\"warnings\">{items}</ul>\n") }
}

fn input_table(inputs: &[InputQuantity]) -> String {
    let head = ["input quantity", "values", "standard uncertainty", "type", "distribution", "after the fit"];
    let row = |input: &InputQuantity| {
        vec![
            input.name.clone(),
            input.count.to_string(),
            input.std_uncertainty.clone(),
            input.kind.to_owned(),
            input.distribution.to_owned(),
            input.posterior.clone(),
        ]
    };
    let rows: Vec<Vec<String>> = inputs.iter().map(row).collect();
    format!("<h2>Input quantities</h2>\n{}", table("text", &head, &rows))
}

/// Channels that one table of the budget has at most: more do not fit on a page.
const MOST_COLUMNS: usize = 6;

/// Contributions to u_c in per cent of the value: tables of each measurand, with a row for each source and a column for
/// each channel.
fn budgets(channels: &[EvaluatedChannel]) -> String {
    let section = |i: usize| {
        let mut names: Vec<&str> = Vec::new();
        for (name, part) in channels.iter().flat_map(|c| &c.measurands[i].contributions) {
            if *part >= LEAST_SHOWN && !names.contains(&name.as_str()) {
                names.push(name);
            }
        }
        let tables = channels.chunks(MOST_COLUMNS).map(|some| budget(some, i, &names));
        format!("<h3>{}</h3>\n{}", MEASURANDS[i], tables.collect::<String>())
    };
    format!(
        "<h2>Budget</h2>\n<p>Contributions |c<sub>i</sub>| u(x<sub>i</sub>) in per cent of the value, whose squares add up to \
         u<sub>c</sub>². “g” is the growth of u<sub>c</sub> because the anisotropy is estimated, too; “other channels” are errors \
         of other materials and channels through what they share.</p>\n{}",
        (0..MEASURANDS.len()).map(section).collect::<String>()
    )
}

fn budget(channels: &[EvaluatedChannel], measurand: usize, names: &[&str]) -> String {
    let labels: Vec<String> = channels.iter().map(EvaluatedChannel::label).collect();
    let head: Vec<&str> = std::iter::once("source").chain(labels.iter().map(String::as_str)).collect();
    let part = |channel: &EvaluatedChannel, name: &str| {
        let contribution = channel.measurands[measurand].contributions.iter().find(|(of, _)| of == name);
        significant(contribution.map_or(0.0, |(_, part)| *part), 2)
    };
    let combined = |channel: &EvaluatedChannel| {
        let m = &channel.measurands[measurand];
        let percent = |u: f64| significant(100.0 * u / m.value.max(f64::MIN_POSITIVE), 2);
        m.std_uncertainty.map_or_else(|| "–".to_owned(), percent)
    };
    let row = |name: &&str| {
        std::iter::once((*name).to_owned()).chain(channels.iter().map(|c| part(c, name))).collect()
    };
    let mut rows: Vec<Vec<String>> = names.iter().map(row).collect();
    rows.push(std::iter::once("u_c".to_owned()).chain(channels.iter().map(combined)).collect());
    table("", &head, &rows)
}

/// Contributions below this share of the value in per cent get no row.
const LEAST_SHOWN: f64 = 0.05;

fn correlations(channels: &[EvaluatedChannel]) -> String {
    /// Most channels of a matrix on a page.
    const MOST: usize = 12;
    let table_of = |i: usize| {
        let labels: Vec<String> = channels.iter().map(EvaluatedChannel::label).collect();
        let head: Vec<&str> = std::iter::once("").chain(labels.iter().map(String::as_str)).collect();
        let cell = |a: &EvaluatedChannel, b: &EvaluatedChannel| minus(&format!("{:.2}", a.correlation(b, i)));
        let row = |a: &EvaluatedChannel| {
            std::iter::once(a.label()).chain(channels.iter().map(|b| cell(a, b))).collect()
        };
        let rows: Vec<Vec<String>> = channels.iter().map(row).collect();
        format!("<h3>{}</h3>\n{}", MEASURANDS[i], table("", &head, &rows))
    };
    let tables = if channels.len() <= MOST {
        (0..MEASURANDS.len()).map(table_of).collect::<String>()
    } else {
        format!(
            "<p>{}</p>\n",
            (0..MEASURANDS.len()).map(|i| spread(channels, i)).collect::<Vec<_>>().join("<br>")
        )
    };
    format!(
        "<h2>Correlations</h2>\n{tables}<p class=\"faint\">media.json has the covariances within and between all channels.</p>\n"
    )
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
        minus(&format!("{first:.2} to {last:.2}, median {:.2}", values[values.len() / 2]))
    };
    let [same, other] = all.map(text);
    format!("{}: {same} within a material, {other} between materials", MEASURANDS[measurand])
}

fn limits() -> String {
    "<h2>Not covered</h2>\n<ul>\n<li>Fluorescence: light that is absorbed and sent out at other wavelengths.</li>\n\
     <li>Variation within a material, between batches, with age, curing or temperature: the values are those of these \
     slabs.</li>\n<li>Polarisation, and materials whose scattering depends on the direction.</li>\n<li>Phase functions \
     that two Henyey–Greenstein lobes do not describe.</li>\n<li>Errors of a set-up beyond its stated \
     uncertainties.</li>\n</ul>\n"
        .to_owned()
}

#[cfg(test)]
mod tests;
