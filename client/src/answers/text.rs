//! Tables of fits.

use farm_proto::fit::{Candidate, ChannelFit, GError, Interval, MaterialFit, Outside, Refined, ScaleCurve};

use crate::output::table;

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

/// `5.9 … 6.2`, with ≤ and ≥ where the data set no bound.
pub(crate) fn interval(i: &Interval, tell: impl Fn(f64) -> String) -> String {
    match (i.open_low, i.open_high) {
        (false, false) if i.low == i.high => "held".to_owned(),
        (false, false) => format!("{} … {}", tell(i.low), tell(i.high)),
        (true, false) => format!("≤ {}", tell(i.high)),
        (false, true) => format!("≥ {}", tell(i.low)),
        (true, true) => "any".to_owned(),
    }
}

fn best(channel: &ChannelFit) -> Option<&Candidate> {
    channel.refined.as_ref().map(|r| &r.best).or(channel.candidates.first())
}

fn channel_names(fits: &[MaterialFit]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for fit in fits.iter().flat_map(|f| &f.channels) {
        if !names.contains(&fit.channel.as_str()) {
            names.push(&fit.channel);
        }
    }
    names
}

/// The paper's Table 1: one row a material, the channels side by side. Unresolved channels are marked.
pub(crate) fn table_one(fits: &[MaterialFit]) -> String {
    type Tell = fn(&Candidate) -> String;
    let quantities: [(&str, Tell); 4] = [
        ("σ_t /mm", |c| significant(c.medium.sigma_t_per_mm(), 3)),
        ("α", |c| albedo(c.medium.albedo())),
        ("g", |c| significant(c.medium.g(), 3)),
        ("error", |c| format!("{:.4}", c.error)),
    ];
    let channels = channel_names(fits);
    let mut head = vec!["material".to_owned()];
    for (name, _) in quantities {
        head.extend(channels.iter().map(|c| format!("{name}\n{c}")));
    }
    let row = |fit: &MaterialFit| {
        let cell = |name: &str, tell: Tell| {
            let channel = fit.channels.iter().find(|c| c.channel == name);
            let Some((channel, best)) = channel.and_then(|c| Some((c, best(c)?))) else {
                return "–".to_owned();
            };
            let unresolved = channel.refined.as_ref().is_some_and(|r| !r.resolved);
            if unresolved { format!("({})", tell(best)) } else { tell(best) }
        };
        let mut row = vec![fit.material.clone()];
        for (_, tell) in quantities {
            row.extend(channels.iter().map(|c| cell(c, tell)));
        }
        row
    };
    let right: Vec<usize> = (1..head.len()).collect();
    let mut text = table(&head.iter().map(String::as_str).collect::<Vec<_>>(), &right, fits.iter().map(row));
    let any = |ok: fn(&Refined) -> bool| {
        fits.iter().flat_map(|f| &f.channels).filter_map(|c| c.refined.as_ref()).any(ok)
    };
    if any(|r| !r.resolved) {
        text += "\n(…) unresolved: the data do not determine the medium; see the bounds below";
    }
    text
}

/// One row a channel: optimum, 95 % intervals, nearest record, remarks.
pub(crate) fn details(fits: &[MaterialFit]) -> String {
    let head = [
        "material",
        "channel",
        "σ_t /mm",
        "95 %",
        "α",
        "95 %",
        "g",
        "95 %",
        "nearest record\nσ_t, α, g",
        "remarks",
    ];
    let rows = fits.iter().flat_map(|fit| fit.channels.iter().map(|c| detail(&fit.material, c)));
    table(&head, &[2, 4, 6], rows)
}

fn detail(material: &str, channel: &ChannelFit) -> Vec<String> {
    let mut row = vec![material.to_owned(), channel.channel.clone()];
    let three = |v: f64| significant(v, 3);
    if let Some(r) = &channel.refined {
        let m = &r.best.medium;
        row.extend([three(m.sigma_t_per_mm()), interval(&r.sigma_t_per_mm, three)]);
        row.extend([albedo(m.albedo()), interval(&r.albedo, albedo)]);
        row.extend([three(m.g()), interval(&r.g, three)]);
    } else {
        row.extend(std::iter::repeat_n("–".to_owned(), 6));
    }
    let record = channel.candidates.first().map(|c| {
        let m = &c.medium;
        format!("{}, {}, {}", m.sigma_t_per_mm(), m.albedo(), m.g())
    });
    row.push(record.unwrap_or_default());
    row.push(remarks(channel).join("; "));
    row
}

/// What a reader of the numbers must know.
pub(crate) fn remarks(channel: &ChannelFit) -> Vec<String> {
    let mut remarks = Vec::new();
    if let Some(r) = &channel.refined {
        if !r.resolved {
            remarks.push("unresolved".to_owned());
        }
        if r.valley {
            let reduced = interval(&r.reduced_scattering_per_mm, |v| significant(v, 3));
            let absorption = interval(&r.absorption_per_mm, |v| significant(v, 2));
            remarks
                .push(format!("σ_t and g trade off: known are σ_s(1−g) {reduced} /mm, σ_a {absorption} /mm"));
        }
    }
    if let Some(outside) = channel.outside {
        let how = match outside {
            Outside::Brighter => "brighter",
            Outside::Darker => "darker",
        };
        remarks.push(format!("outside: {how} than every record"));
    }
    remarks
}

/// What the search of Eq. 3 found.
pub(crate) fn scale_text(scale: &ScaleCurve) -> String {
    let error = scale.std_error.map_or(String::new(), |e| format!(" ± {}", significant(e, 1)));
    let mut text = format!("scale factor μ* = {}{error} (error {:.4})", scale.best.mu, scale.best.error);
    if let Some(curvature) = scale.curvature {
        // A parabola with this curvature: e(μ) = e(μ*) (1 + ½ c (μ − μ*)²).
        text += &format!("; 0.01 away from it the error is {:.2} % larger", 0.5 * curvature * 1e-4 * 100.0);
    }
    if scale.at_end {
        text += "
μ* lies at an end of the values tried: widen them with --mu-min and --mu-max";
    }
    if scale.by_g.len() > 1 {
        let row = |e: &GError| {
            let mark = if e.g == scale.best_g { " (best)" } else { "" };
            vec![
                format!("{}{mark}", e.g),
                format!("{:.4}", e.error),
                e.best.mu.to_string(),
                format!("{:.4}", e.best.error),
            ]
        };
        let head = [
            "g common
to all",
            "error
at μ*",
            "its own
best μ",
            "error
there",
        ];
        text += &format!(
            "

{}",
            table(&head, &[0, 1, 2, 3], scale.by_g.iter().map(row))
        );
    }
    text
}

/// The table as CSV: one row a channel.
pub(crate) fn table_csv(fits: &[MaterialFit]) -> anyhow::Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record([
        "material",
        "channel",
        "sigma_t_per_mm",
        "sigma_t_low",
        "sigma_t_high",
        "albedo",
        "albedo_low",
        "albedo_high",
        "g",
        "g_low",
        "g_high",
        "error",
        "resolved",
        "grid_sigma_t_per_mm",
        "grid_albedo",
        "grid_g",
        "grid_error",
        "remarks",
    ])?;
    for fit in fits {
        for channel in &fit.channels {
            let (Some(r), Some(grid)) = (&channel.refined, channel.candidates.first()) else { continue };
            let low = |i: &Interval| if i.open_low { String::new() } else { i.low.to_string() };
            let high = |i: &Interval| if i.open_high { String::new() } else { i.high.to_string() };
            let (m, n) = (&r.best.medium, &grid.medium);
            let mut row = vec![fit.material.clone(), channel.channel.clone()];
            row.extend([m.sigma_t_per_mm().to_string(), low(&r.sigma_t_per_mm), high(&r.sigma_t_per_mm)]);
            row.extend([m.albedo().to_string(), low(&r.albedo), high(&r.albedo)]);
            row.extend([m.g().to_string(), low(&r.g), high(&r.g)]);
            row.extend([r.best.error.to_string(), r.resolved.to_string()]);
            row.extend([n.sigma_t_per_mm(), n.albedo(), n.g(), grid.error].map(|v| v.to_string()));
            row.push(remarks(channel).join("; "));
            writer.write_record(&row)?;
        }
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// The best records of one channel, with the terms of their errors.
pub(crate) fn neighbours(candidates: &[Candidate]) -> String {
    let terms = candidates.first().map_or(&[][..], |c| &c.thicknesses);
    let mut head = vec!["error".to_owned(), "σ_t /mm".into(), "α".into(), "g".into(), "index".into()];
    for term in terms {
        head.push(format!("rms values\n{} mm", term.thickness_mm));
        head.push(format!("rms gradients\n{} mm", term.thickness_mm));
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
    use super::*;

    #[test]
    fn numbers_have_as_many_digits_as_they_need() {
        let told = [6.0, 5.994, 0.12345, 24.04, 123.4, 0.0].map(|v| significant(v, 3));
        assert_eq!(told, ["6", "5.99", "0.123", "24", "123", "0"]);
        assert_eq!(
            [0.05, 0.9991, 0.999_903, 0.35, 1.0].map(albedo),
            ["0.05", "0.9991", "0.999903", "0.35", "1"]
        );
    }

    #[test]
    fn intervals_tell_where_the_data_set_no_bound() {
        let tell = |low, high, open_low, open_high| {
            interval(&Interval { low, high, open_low, open_high }, |v| significant(v, 2))
        };
        assert_eq!(tell(1.0, 2.0, false, false), "1 … 2");
        assert_eq!(tell(1.0, 2.0, true, false), "≤ 2");
        assert_eq!(tell(1.0, 2.0, false, true), "≥ 1");
        assert_eq!(tell(1.0, 2.0, true, true), "any");
        assert_eq!(tell(0.4, 0.4, false, false), "held");
    }
}
