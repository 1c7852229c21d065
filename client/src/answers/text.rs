//! Tables of fits.

use optics_model::fit::{Candidate, ChannelFit, Common, GError, Interval, MaterialFit, Outside, ScaleCurve};

use super::misfit::misfit;
use crate::output::{table, warning};

/// A number with so many significant digits, without trailing zeros.
pub(crate) fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let decimals = (digits - 1 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// An albedo with so many digits that 1 − α has three.
pub(crate) fn albedo(value: f64) -> String {
    let co_albedo = 1.0 - value;
    if co_albedo <= 0.0 {
        return "1".to_owned();
    }
    let decimals = (2 - co_albedo.log10().floor() as i32).clamp(2, 9) as usize;
    let text = format!("{value:.decimals$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// An albedo with so many digits that 1 − α has two, for the ends of intervals.
fn albedo_end(value: f64) -> String {
    let co_albedo = 1.0 - value;
    let decimals = if co_albedo <= 0.0 { 2 } else { (1 - co_albedo.log10().floor() as i32).clamp(2, 6) };
    let text = format!("{value:.*}", decimals as usize);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// `5.9…6.2`, with ≤ and ≥ where the data set no bound.
pub(crate) fn interval(i: &Interval, tell: impl Fn(f64) -> String) -> String {
    match (i.open_low, i.open_high) {
        (false, false) if i.low == i.high => "held".to_owned(),
        (false, false) => format!("{}…{}", tell(i.low), tell(i.high)),
        (true, false) => format!("≤ {}", tell(i.high)),
        (false, true) => format!("≥ {}", tell(i.low)),
        (true, true) => "any".to_owned(),
    }
}

/// Longest name of a material in a table of 80 columns.
const LONGEST_NAME: usize = 8;

/// A name with its end cut off where it would make a table too wide.
fn short(name: &str) -> String {
    if name.chars().count() <= LONGEST_NAME {
        return name.to_owned();
    }
    name.chars().take(LONGEST_NAME - 1).chain(['…']).collect()
}

/// The fits of all channels: what is known best, the media, and what a reader must know of them.
pub(crate) fn fits_text(fits: &[MaterialFit]) -> String {
    let all = || fits.iter().flat_map(|f| f.channels.iter().map(move |c| (f, c)));
    let mut text = String::new();
    if all().any(|(_, c)| c.refined.is_some()) {
        text += &known(fits);
        text += "\n\n";
    }
    text += &media(fits);
    // What is said of several channels is said once.
    let mut said: Vec<(String, Vec<String>)> = Vec::new();
    let mut warned: Vec<String> = Vec::new();
    for (fit, channel) in all() {
        let who = format!("{} {}", fit.material, channel.channel);
        warned.extend(warnings(channel));
        for remark in remarks(channel) {
            match said.iter_mut().find(|(other, _)| *other == remark) {
                Some((_, of)) => of.push(who.clone()),
                None => said.push((remark, vec![who.clone()])),
            }
        }
    }
    for (remark, of) in said {
        let line = wrapped(&format!("{}: {remark}", of.join(", ")));
        text += &format!("\n{}", if warned.contains(&remark) { warning(&line) } else { line });
    }
    text
}

/// A line of text in lines of at most 80 columns.
fn wrapped(text: &str) -> String {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.last_mut().expect("there is a line");
        let wide = last.chars().count() + 1 + word.chars().count() > 80;
        if last.is_empty() || !wide {
            let space = if last.is_empty() { "" } else { " " };
            *last += space;
            *last += word;
        } else {
            lines.push(format!("  {word}"));
        }
    }
    lines.join("\n")
}

/// One row a channel: σ_s(1 − g) and σ_a, which similar media share.
fn known(fits: &[MaterialFit]) -> String {
    let head = ["material", "ch", "σ_s(1−g)\n/mm", "\n95 %", "σ_a\n/mm", "\n95 %", "misfit", "error"];
    let three = |v: f64| significant(v, 3);
    let two = |v: f64| significant(v, 2);
    let row = |material: &str, channel: &ChannelFit| {
        let mut row = vec![short(material), channel.channel.clone()];
        if let Some(r) = &channel.refined {
            let m = &r.best.medium;
            row.extend([three(m.reduced_scattering_per_mm()), interval(&r.reduced_scattering_per_mm, three)]);
            row.extend([two(m.absorption_per_mm()), interval(&r.absorption_per_mm, two)]);
            row.extend([two(r.misfit), format!("{:.4}", r.best.error)]);
        } else {
            row.extend(std::iter::repeat_n("–".to_owned(), 6));
        }
        row
    };
    let rows = fits.iter().flat_map(|fit| fit.channels.iter().map(|c| row(&fit.material, c)));
    format!("what similar media share, whatever g is\n{}", table(&head, &[2, 4, 6, 7], rows))
}

/// One row a channel: σ_t, α and g with their intervals; without refinement, those of the best record.
fn media(fits: &[MaterialFit]) -> String {
    let three = |v: f64| significant(v, 3);
    let refined = fits.iter().flat_map(|f| &f.channels).any(|c| c.refined.is_some());
    let mut head = vec!["material", "ch", "σ_t\n/mm", "\n95 %", "α", "\n95 %", "g", "\n95 %"];
    if !refined {
        head = vec!["material", "ch", "σ_t\n/mm", "α", "g", "error"];
    }
    let row = |material: &str, channel: &ChannelFit| {
        let mut row = vec![short(material), channel.channel.clone()];
        match (&channel.refined, channel.candidates.first()) {
            (Some(r), _) => {
                let m = &r.best.medium;
                let mark = |value: String| if r.resolved { value } else { format!("({value})") };
                row.extend([mark(three(m.sigma_t_per_mm())), interval(&r.sigma_t_per_mm, three)]);
                row.extend([mark(albedo(m.albedo())), interval(&r.albedo, albedo_end)]);
                row.extend([three(m.g()), interval(&r.g, |v| significant(v, 2))]);
            }
            (None, Some(c)) => {
                let m = &c.medium;
                row.extend([m.sigma_t_per_mm(), m.albedo(), m.g()].map(|v| v.to_string()));
                row.push(format!("{:.4}", c.error));
            }
            (None, None) => row.resize(head.len(), "–".to_owned()),
        }
        row
    };
    let rows = fits.iter().flat_map(|fit| fit.channels.iter().map(|c| row(&fit.material, c)));
    let right: &[usize] = if refined { &[2, 4, 6] } else { &[2, 3, 4, 5] };
    let unresolved =
        fits.iter().flat_map(|f| &f.channels).filter_map(|c| c.refined.as_ref()).any(|r| !r.resolved);
    let note = if unresolved {
        "\n(…) unresolved: these data leave the medium open within the bounds told"
    } else {
        ""
    };
    let title = if refined { "media" } else { "best records of the dictionary" };
    format!("{title}\n{}{note}", table(&head, right, rows))
}

/// What a reader of the numbers must know.
pub(super) fn remarks(channel: &ChannelFit) -> Vec<String> {
    let valley = channel.refined.as_ref().is_some_and(|r| r.valley);
    let advice = valley.then(|| "σ_t and g trade off: trust σ_s(1−g) and σ_a".to_owned());
    warnings(channel).into_iter().chain(advice).collect()
}

/// Why the numbers may not be trusted.
fn warnings(channel: &ChannelFit) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(r) = &channel.refined {
        warnings.extend(misfit(r));
        if !r.resolved && channel.outside.is_none() {
            warnings.push(unresolved(&r.sigma_t_per_mm));
        }
    }
    if let Some(outside) = channel.outside {
        let (how, what) = match outside {
            Outside::Brighter => ("brighter", "white reference, scale factor"),
            Outside::Darker => ("darker", "black level, scale factor"),
        };
        warnings.push(format!(
            "outside the dictionary: {how} than every record; check {what}, or compute a wider dictionary"
        ));
    }
    warnings
}

/// Why a channel is unresolved: the data, or a dictionary that ends where they would go on.
fn unresolved(sigma_t: &Interval) -> String {
    let narrow = sigma_t.high <= 2.0 * sigma_t.low && (sigma_t.open_low != sigma_t.open_high);
    if !narrow {
        return "unresolved: the data do not determine the medium".to_owned();
    }
    let (side, end) = if sigma_t.open_high { ("above", sigma_t.high) } else { ("below", sigma_t.low) };
    format!(
        "unresolved: σ_t may lie {side} {} /mm, where the dictionary or --sigma-t ends; compute a wider dictionary, or \
         tell g",
        significant(end, 3)
    )
}

/// What was chosen for all channels, or given.
pub(crate) fn common_text(common: &Common) -> String {
    let i = &common.mu_interval;
    let mut lines = Vec::new();
    if !common.mu_chosen {
        lines.push(format!("scale factor μ = {}, as given", common.mu));
    } else if i.open_low && i.open_high {
        lines.push(format!(
            "scale factor μ: not determined by these data; taken as {} ± {} (tried: {} to {}). If the photographs are \
             calibrated, tell it: --mu 1",
            significant(common.mu, 4),
            significant(common.mu_std_error, 1),
            i.low,
            i.high
        ));
    } else {
        let (mu, error) = (significant(common.mu, 4), significant(common.mu_std_error, 1));
        let mut line = format!("scale factor μ = {mu} ± {error}, chosen by the errors of refined fits");
        if i.open_low || i.open_high {
            line += "; it may lie beyond the values tried: widen them with --mu-min and --mu-max";
        }
        lines.push(line);
    }
    match (common.g, &common.g_interval) {
        (Some(g), Some(i)) => {
            let told = interval(i, |v| significant(v, 2));
            lines.push(format!(
                "anisotropy g = {}, chosen as common to all channels (95 %: {told})",
                significant(g, 3)
            ));
        }
        (Some(g), None) => lines.push(format!("anisotropy g = {g}: given, or the dictionary's only one")),
        (None, _) => lines.push("every channel has its own anisotropy".to_owned()),
    }
    lines.iter().map(|l| wrapped(l)).collect::<Vec<_>>().join("\n")
}

/// The paper's search of Eq. 3, by the errors of the best records.
pub(crate) fn scale_text(scale: &ScaleCurve) -> String {
    let error = scale.std_error.map_or(String::new(), |e| format!(" ± {}", significant(e, 1)));
    let mut text = format!(
        "by the best records alone, as in the paper's Eq. 3: μ* = {}{error}\n(error {:.4}",
        scale.best.mu, scale.best.error
    );
    // A parabola with this curvature: e(μ) = e(μ*) (1 + ½ c (μ − μ*)²).
    match scale.curvature {
        Some(c) if c > 0.0 => {
            text += &format!("; 0.01 away from it the error is {:.2} % larger)", 0.5 * c * 1e-4 * 100.0);
        }
        Some(_) => text += "; near it the error does not rise: the minimum is not sharp)",
        None => text += ")",
    }
    if scale.at_end {
        text += "\nμ* lies at an end of the values tried: widen them with --mu-min and --mu-max";
    }
    if scale.by_g.len() > 1 {
        let row = |e: &GError| {
            let mark = if e.g == scale.best_g { " (best)" } else { "" };
            let there = format!("{:.4}", e.best_mu_error);
            vec![format!("{}{mark}", e.g), format!("{:.4}", e.error), e.best_mu.to_string(), there]
        };
        let head = ["g common\nto all", "error\nat μ*", "its own\nbest μ", "error\nthere"];
        text += &format!("\n\n{}", table(&head, &[0, 1, 2, 3], scale.by_g.iter().map(row)));
    }
    text
}

/// The best records of one channel, with the terms of their errors: root mean squares of differences.
pub(crate) fn neighbours(candidates: &[Candidate]) -> String {
    let terms = candidates.first().map_or(&[][..], |c| &c.thicknesses);
    let mut head = vec!["error".to_owned(), "σ_t /mm".into(), "α".into(), "g".into(), "index".into()];
    for term in terms {
        head.push(format!("values\n{} mm", term.thickness_mm));
        head.push(format!("gradients\n{} mm", term.thickness_mm));
    }
    let rows = candidates.iter().map(|c| {
        let m = &c.medium;
        let mut row = vec![format!("{:.5}", c.error)];
        row.extend([m.sigma_t_per_mm(), m.albedo(), m.g(), c.sample_ior].map(|v| v.to_string()));
        for t in &c.thicknesses {
            row.extend([format!("{:.5}", t.value_rms), format!("{:.6}", t.gradient_rms)]);
        }
        row
    });
    let right: Vec<usize> = (0..head.len()).collect();
    table(&head.iter().map(String::as_str).collect::<Vec<_>>(), &right, rows)
}

#[cfg(test)]
mod tests {
    use super::super::table_csv;
    use super::*;
    use crate::testing::channel;

    #[test]
    fn numbers_have_as_many_digits_as_they_need() {
        let told = [6.0, 5.994, 0.12345, 24.04, 123.4, 0.0].map(|v| significant(v, 3));
        assert_eq!(told, ["6", "5.99", "0.123", "24", "123", "0"]);
        assert_eq!(
            [0.05, 0.9991, 0.999_903, 0.35, 1.0].map(albedo),
            ["0.05", "0.9991", "0.999903", "0.35", "1"]
        );
    }

    /// Nothing is wider than a terminal of 80 columns, however long the names, and warnings are told once.
    #[test]
    fn fits_are_told_in_eighty_columns_with_what_is_wrong() {
        let mut channels =
            vec![channel("R", 11.53, 3.42), channel("G", 27.61, 0.96), channel("B", 19.87, 0.93)];
        for channel in &mut channels[1..] {
            channel.refined.as_mut().unwrap().resolved = false;
        }
        let fits = [MaterialFit { material: "Vero White Plus".into(), channels }];
        let text = anstream::adapter::strip_str(&fits_text(&fits)).to_string();
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{} columns: {line}", line.chars().count());
        }
        let (shared, media) = (text.find("σ_s(1−g)").unwrap(), text.find("σ_t").unwrap());
        assert!(shared < media, "what is known best comes first");
        let flat = text.replace("\n  ", " ");
        for told in [
            "Vero White Plus R: misfit 3.4: the intervals are not to be trusted; likeliest is an edge at x = 0.071 mm \
             instead of 0 in the profile of 0.5 mm: shift its x_mm (misfit 1 without that)",
            "Vero White Plus G, Vero White Plus B: unresolved: the data do not determine the medium",
        ] {
            assert!(flat.contains(told), "{told}\n{flat}");
        }
        let csv = table_csv(&fits).unwrap();
        assert!(csv.lines().nth(1).unwrap().contains("misfit 3.4: the intervals"), "{csv}");
    }

    /// What the errors do beside their least is told as it is.
    #[test]
    fn a_scale_factor_that_the_data_leave_open_is_told_so() {
        let open = Interval { low: 0.8, high: 1.1, open_low: true, open_high: true };
        let closed = Interval { low: 0.35, high: 0.47, open_low: false, open_high: false };
        let mut common = Common {
            mu: 1.0,
            mu_std_error: 0.0919,
            mu_interval: open,
            mu_chosen: true,
            g: Some(0.4123),
            g_interval: Some(closed),
            by_g: Vec::new(),
        };
        let told = common_text(&common).replace("\n  ", " ");
        assert!(
            told.starts_with("scale factor μ: not determined by these data; taken as 1 ± 0.09"),
            "{told}"
        );
        assert!(
            told.ends_with("anisotropy g = 0.412, chosen as common to all channels (95 %: 0.35…0.47)"),
            "{told}"
        );
        assert!(!told.contains("held"));
        common.mu_chosen = false;
        assert!(common_text(&common).starts_with("scale factor μ = 1, as given"));
        let scale = |curvature| ScaleCurve {
            points: Vec::new(),
            best: optics_model::fit::ScalePoint { mu: 0.913, error: 0.2 },
            std_error: None,
            curvature: Some(curvature),
            at_end: false,
            by_g: Vec::new(),
            best_g: 0.4,
        };
        assert!(scale_text(&scale(50.0)).contains("0.01 away from it the error is 0.25 % larger"));
        assert!(!scale_text(&scale(-50.0)).contains("larger"));
    }

    #[test]
    fn intervals_tell_where_the_data_set_no_bound() {
        let tell = |low, high, open_low, open_high| {
            interval(&Interval { low, high, open_low, open_high }, |v| significant(v, 2))
        };
        assert_eq!(tell(1.0, 2.0, false, false), "1…2");
        assert_eq!(tell(1.0, 2.0, true, false), "≤ 2");
        assert_eq!(tell(1.0, 2.0, false, true), "≥ 1");
        assert_eq!(tell(1.0, 2.0, true, true), "any");
        assert_eq!(tell(0.4, 0.4, false, false), "held");
    }
}
