use farm_figures::testing;
use optics_model::fit::SharedErrors;

use super::*;

fn fits() -> Vec<MaterialFit> {
    let mut channel = testing::channel("R", 6.0, 1.0);
    let refined = channel.refined.as_mut().unwrap();
    refined.covariance = [[2.5e-3, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 0.01]];
    ["white", "<cyan>"]
        .map(|name| MaterialFit { material: name.into(), channels: vec![channel.clone()] })
        .to_vec()
}

fn page_of(record: &SessionRecord, errors: &SharedErrors) -> String {
    UncertaintyStatement {
        fits: &fits(),
        shared_errors: errors,
        common: &testing::common(),
        record: Some(record),
        dictionary: "lab",
        digest: "0123",
    }
    .document()
    .page()
}

/// Asserts that a page has all of these parts.
fn has(page: &str, parts: &[&str]) {
    for part in parts {
        assert!(page.contains(part), "{part}: {page}");
    }
}

/// Values have their combined uncertainty, k, ν_eff and interval; names are escaped; contributions add up to u_c.
#[test]
fn statements_have_results_and_budget() {
    let page = page_of(&SessionRecord::default(), &SharedErrors::default());
    let fits = fits();
    let channels = evaluated(&fits, &SharedErrors::default());
    let m = &channels[0].measurands[0];
    let variance = fits[0].channels[0].refined.as_ref().unwrap().covariance[0][0];
    let u = m.std_uncertainty.unwrap();
    assert!((u - 6.0 * variance.sqrt()).abs() < 1e-9, "{m:?}");
    let squares: f64 = m.contributions.iter().map(|(_, part)| part * part).sum();
    let relative = 100.0 * u / m.value;
    assert!((squares.sqrt() / relative - 1.0).abs() < 0.01, "{squares} {relative}");
    let parts = [
        "<td>σ_t</td><td class=\"number\">6.00</td><td class=\"number\">0.30</td>",
        "<td>&lt;cyan&gt;</td>",
        "<h2>Budget</h2>",
        "add up to u<sub>c</sub>²",
        "<th class=\"number\">&lt;cyan&gt; R</th>",
        "No certificate is stated for the white reference, the thickness of the slabs and the board's squares",
    ];
    has(&page, &parts);
}

/// Correlations of two channels follow from the errors that they share.
#[test]
fn correlations_follow_from_shared_errors() {
    let fits = fits();
    let sd = fits[0].channels[0].refined.as_ref().unwrap().covariance[0][0].sqrt();
    let media = vec![[0.8 * sd, 0.0, 0.0, 0.0, 0.0], [-0.5 * sd, 0.0, 0.0, 0.0, 0.0]];
    let errors = SharedErrors { sources: 1, media, scene: Vec::new() };
    let channels = evaluated(&fits, &errors);
    assert!((channels[0].correlation(&channels[1], 0) + 0.4).abs() < 1e-9);
    assert_eq!(channels[0].correlation(&channels[0], 0), 1.0);
    assert!(page_of(&SessionRecord::default(), &errors).contains("<td class=\"number\">−0.40</td>"));
}

/// Entries of the session are stated; with all three certificates traceability is.
#[test]
fn certificates_are_stated() {
    let text = |text: &str| Some(text.to_owned());
    let record = SessionRecord {
        operator: text("A. B."),
        white_certificate: text("W-1"),
        thickness_certificate: text("T-1"),
        scale_certificate: text("S-1"),
        ..SessionRecord::default()
    };
    let page = page_of(&record, &SharedErrors::default());
    let parts =
        ["<td>Operator</td><td>A. B.</td>", "<td>W-1</td>", "are traceable through these certificates"];
    has(&page, &parts);
    let wrong = SessionRecord { conditions: text("a\nb"), ..record }.checked().unwrap_err().to_string();
    assert!(wrong.starts_with("record.conditions = \"a\\nb\""), "{wrong}");
}

/// A slab has one thickness in all channels, the session one white reference.
#[test]
fn inputs_are_counted_once() {
    use optics_model::fit::{Nuisance, NuisanceEstimate};
    let mut fits = fits();
    let estimate = |nuisance, profile_mm| NuisanceEstimate {
        nuisance,
        profile_mm,
        // A blur of 40 µm.
        value: 0.0016,
        std_error: 0.001,
        prior: 0.0,
        prior_std_error: 0.002,
    };
    let all = [
        (Nuisance::Scale, None),
        (Nuisance::Thickness, Some(0.5)),
        (Nuisance::Gain, Some(0.5)),
        (Nuisance::BlurVariance, None),
        (Nuisance::Origin, Some(0.5)),
    ];
    for fit in &mut fits {
        let mut channel = fit.channels[0].clone();
        let refined = channel.refined.as_mut().unwrap();
        refined.likelihood.nuisances = all.map(|(nuisance, mm)| estimate(nuisance, mm)).to_vec();
        fit.channels =
            vec![channel.clone(), optics_model::fit::ChannelFit { channel: "G".into(), ..channel }];
    }
    // Blur and edge are estimated from photographs only where there are some.
    let rows = |is_captured| -> Vec<[String; 4]> {
        let rows = input_rows(&fits, is_captured).into_iter().skip(2);
        rows.map(|row| [0, 1, 2, 3].map(|column| row[column].clone())).collect()
    };
    let captured = [
        ["white reference: scale factor 1/μ", "1", "0.002", "B"],
        ["thickness of a slab", "2", "0.002 mm", "B"],
        ["gain of a profile", "4", "0.002", "B"],
        ["blur of the camera", "2", "20 µm", "A"],
        ["place of the edge", "4", "0.002 mm", "A"],
    ];
    assert_eq!(rows(true), captured.map(|row| row.map(str::to_owned)));
    assert!(rows(false).iter().all(|row| row[3] == "B"));
}

/// Undetermined media, open ends, residuals beyond noise and values from mixtures are stated before the values.
#[test]
fn doubtful_results_are_marked() {
    let mut fits = fits();
    let refined = fits[1].channels[0].refined.as_mut().unwrap();
    (refined.resolved, refined.sigma_t_per_mm.open_high) = (false, true);
    (refined.likelihood.probability, refined.misfit, refined.from_mixtures) = (1e-9, 4.7, true);
    let channels = evaluated(&fits, &SharedErrors::default());
    assert_eq!(channels[1].measurands[0].std_uncertainty, None);
    assert!(channels[1].measurands[1].contributions.is_empty());
    let doubts: Vec<String> = doubts(&channels).iter().map(Remark::sentence).collect();
    assert_eq!(doubts[0], "<cyan> R: the data do not determine σ_t and the albedo separately");
    assert!(doubts[1].contains("(up to 4.7 times)") && doubts[2].contains("from mixtures"), "{doubts:?}");
}
