//! Tests the texts of answers as users read them.

use farm_figures::error_budget;
use farm_figures::misfit::misfit_short;
use farm_figures::testing::{channel, common, design, likelihood, scale_curve, scene_estimates, unmixed};
use farm_lab::capture::budget_blocks;
use optics_model::fit::{
    Cause, ChannelFit, Common, Design, DesignQuestion, DesignSettings, GError, Interval, MaterialFit,
    PixelRow, ScaleCurve, ScalePoint, Suspicion,
};

use super::*;
use crate::output::lines;
use crate::testing::is_stable;

fn fit(material: &str, channels: &[ChannelFit]) -> [MaterialFit; 1] {
    [MaterialFit { material: material.to_owned(), channels: channels.to_vec() }]
}

/// Answers with every remark: a good channel and an unexplained one, media that are not determined, and records alone.
fn fits() -> [String; 2] {
    let mut mixed = [channel("R", 11.53, 1.0), channel("G", 27.61, 1.0)];
    mixed[1].refined.as_mut().unwrap().likelihood = likelihood(1130.0, 1e-9);
    let mut open = [channel("R", 11.53, 3.42), channel("G", 27.61, 0.96), channel("B", 19.87, 0.93)];
    for channel in &mut open[1..] {
        let refined = channel.refined.as_mut().unwrap();
        (refined.resolved, refined.resolved_at_g) = (false, false);
    }
    let records = mixed.clone().map(|channel| ChannelFit { refined: None, ..channel });
    let [mixed, open, records] =
        [fit("white", &mixed), fit("Vero White Plus", &open), fit("white", &records)];
    let assumed = || Some("assumed: origin ± 0.05 mm, gain ± 0.3 %".to_owned());
    let reports = [(&mixed, assumed(), true), (&open, None, false), (&records, assumed(), false)];
    let text = |(fits, assumed, bound): (&[MaterialFit; 1], _, _)| {
        lines(&fits_blocks(&FitsReport { fits, assumed, bound, scene: true }))
    };
    [reports.map(text).join("\n"), found::table_csv(&open).unwrap()]
}

/// Bounds of an exact and of an uncertain scene; of records there are none.
fn bounds() -> String {
    let record = ChannelFit { refined: None, ..channel("G", 9.0, 1.0) };
    let mut uncertain = channel("R", 6.0, 1.0);
    uncertain.refined.as_mut().unwrap().likelihood.scene = scene_estimates();
    let all = [
        fit("white", &[channel("R", 6.0, 1.0), record.clone()]),
        fit("white", &[uncertain]),
        fit("white", &[record]),
    ];
    all.map(|fits| lines(&fits::bounds(&fits))).join("\n")
}

/// The best design, one that determines nothing, and one for a single anisotropy.
fn designs() -> String {
    let [mut hopeless, mut single] = [design(), design()];
    hopeless.sets.iter_mut().for_each(|set| set.best = false);
    single.pixels = PixelRow::new(-1.0, 1.0, 0.1).unwrap();
    single.sets.iter_mut().for_each(|set| set.g_free = None);
    let text = |design: Design| {
        let question = DesignQuestion::new(DesignSettings::of(design.medium)).unwrap();
        lines(&design_blocks(&design, &question))
    };
    [design(), hopeless, single].map(text).join("\n")
}

/// Factors that are undetermined, estimated and given, with a chosen g, a given one and the best of all; curves that have
/// a minimum, and that have none.
fn scales() -> String {
    let interval = |low, high, open| Interval { low, high, open_low: open, open_high: open };
    let by_g = [0.35, 0.45].map(|g| GError { g, error: 0.2, best_mu: 1.0, best_mu_error: 0.2 });
    let open = Common {
        mu: 1.0,
        mu_std_error: 0.0919,
        mu_interval: interval(0.8, 1.1, true),
        g: Some(0.4123),
        g_interval: Some(interval(0.35, 0.47, false)),
        ..common()
    };
    let found = Common { mu_chosen: false, ..open.clone() };
    let given = Common { mu_std_error: 0.0, g_interval: None, ..found.clone() };
    let best = Common { by_g: by_g.to_vec(), ..given.clone() };
    let best_point = ScalePoint { mu: 0.913, error: 0.2 };
    let curve = |curvature| ScaleCurve {
        best: best_point,
        std_error: None,
        curvature: Some(curvature),
        ..scale_curve()
    };
    let texts = [open, found, given, best].map(|common| common_text(&common));
    texts
        .into_iter()
        .chain([50.0, -50.0].map(|c| lines(&scale_blocks(&curve(c)))))
        .collect::<Vec<_>>()
        .join("\n")
}

/// An unlikely χ² warns whatever the misfit, with the suspicion and without; a likely one only with a suspicion.
fn misfits() -> String {
    let refined = channel("R", 6.0, 3.4).refined.unwrap();
    let power = Suspicion { cause: Cause::Exponent, amount: 0.9, thickness_mm: None, misfit_left: 1.0 };
    let mut text = String::new();
    for (chi2, probability, suspicion) in [
        (1130.2, 2e-9, refined.suspicion),
        (1130.2, 2e-9, None),
        (712.0, 0.5, Some(power)),
        (712.0, 0.001, None),
    ] {
        let mut refined = refined.clone();
        (refined.likelihood, refined.suspicion) = (likelihood(chi2, probability), suspicion);
        text += &format!("{:?}\n{:?}\n", remarks::misfit(&refined), misfit_short(&refined));
        text += &format!("{:#?}\n", likelihood::findings(&refined));
    }
    text
}

/// All media are determined, one is not, and there are none.
fn verdicts() -> String {
    let mut channels = ["R", "G", "B"].map(|name| channel(name, 6.0, 1.0));
    let all = verdict(&fit("white", &channels));
    channels[0].refined.as_mut().unwrap().resolved_at_g = false;
    let sigma_t = &mut channels[1].refined.as_mut().unwrap().sigma_t_per_mm;
    (sigma_t.low, sigma_t.high) = (5.88, 6.12);
    let some = verdict(&fit("white", &channels));
    [all, some, verdict(&[])].map(|verdict| lines(&verdict.blocks()) + &format!("\n{verdict:#?}")).join("\n")
}

/// The texts without their colours; those of whole answers fit a terminal of 80 columns.
#[test]
fn texts_of_answers_are_stable() {
    let budget = error_budget(&fit("white", &[channel("G", 6.0, 1.0)])).unwrap();
    let [fits, table] = fits();
    for (name, text) in [
        ("fits", fits),
        ("table", table),
        ("bounds", bounds()),
        ("budget", lines(&budget_blocks(&budget))),
        ("designs", designs()),
        ("inks", lines(&inks_blocks(&unmixed()))),
        ("scales", scales()),
        ("misfits", misfits()),
        ("verdicts", verdicts()),
    ] {
        let text = anstream::adapter::strip_str(&text).to_string();
        for line in text.lines().filter(|_| ["fits", "designs", "inks"].contains(&name)) {
            assert!(line.chars().count() <= 80, "{line}");
        }
        is_stable(&format!("answers/tests/{name}.txt"), &(text + "\n"));
    }
}

/// A capture removes all files of media that an earlier measurement wrote into its folder.
#[test]
fn captures_remove_files_of_media() {
    let files = media_files(&fit("white", &[channel("R", 6.0, 1.0)])).unwrap();
    let all = farm_lab::research_object::MEASURED_FILES;
    assert!(files.iter().all(|(name, _)| all.contains(name)), "{all:?}");
}
