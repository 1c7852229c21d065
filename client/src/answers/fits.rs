//! Fits as people read them.

use optics_model::fit::{Candidate, ChannelFit, MaterialFit};

use super::numbers::{albedo, albedo_end, interval, significant};
use super::remarks::{remarks, warnings};
use crate::output::{table, warning, wrapped};

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
}
