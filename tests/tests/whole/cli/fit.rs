//! The commands that fit: set-up, JSON shapes, mixtures, designs.

use std::path::Path;

use farm_tests::cli::{HEAD, fails, farm, json, keys, rows, write};
use farm_tests::process::run;
use optics_model::quantities::Quantity;
use serde_json::{Value, json as value};

/// All commands that fit take the set-up from the session and from options.
#[test]
fn all_fits_take_the_session_set_up() {
    let farm = farm();
    let dir = farm.path();
    let profile: String = rows("R", 0.5).lines().map(|line| format!("{line},0.001\n")).collect();
    let head = HEAD.replace("value", "value,thickness_std_error_mm");
    write(dir, "m.csv", &(head + &profile));
    write(
        dir,
        "session.json",
        r#"{"format": "farmctl-session/1", "gain_std_error": 0.01, "slope_std_error": 0.004, "camera": "any",
            "blur_mm": {"R": 0.025, "G": 0.024}, "blur_std_error_mm": 0.001}"#,
    );
    for verb in ["fit", "scale", "measure", "map"] {
        let options = ["--session", "session.json", "--slope-std-error", "0", "--objective", "paper"];
        let ran = run(dir, &[&[verb, "m.csv", "--dictionary", "grid", "--json"][..], &options].concat());
        let data = json(&ran, verb);
        let numbers = ["gain_std_error", "slope_std_error", "blur_std_error_mm", "origin_std_error_mm"];
        assert_eq!(numbers.map(|n| data[n].as_f64().unwrap()), [0.01, 0.0, 0.001, 0.05], "{verb}");
        assert_eq!(data["objective"], "paper", "{verb}");
        assert_eq!(data["assumed"], value!(["origin_std_error_mm", "offset_std_error"]), "{verb}");
    }
}

/// Every answer of the fit has its JSON shape.
#[test]
fn every_fit_answer_has_its_json_shape() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "m.csv", &(HEAD.to_owned() + &rows("R", 0.5) + &rows("R", 1.0)));
    let fit = json(&run(dir, &["fit", "m.csv", "--dictionary", "grid", "--json", "--top", "2"]), "fit");
    let options = [
        "albedo_range",
        "assumed",
        "dictionary",
        "g",
        "g_range",
        "lambda",
        "level",
        "mu",
        "mu_std_error",
        "objective",
        "phase",
        "sigma_t_range",
        "wavelet",
    ];
    let with = |more: &[&str]| {
        let set_up = Quantity::OF_OPTIONS.iter().map(|quantity| quantity.name);
        let mut all: Vec<_> = options.iter().chain(more).copied().chain(set_up).map(str::to_owned).collect();
        all.sort();
        all
    };
    assert_eq!(keys(&fit), with(&["materials", "notes"]));
    let channel = &fit["materials"][0]["channels"][0];
    assert_eq!(keys(channel), ["candidates", "channel", "outside", "refined"]);
    let expected = [
        "absorption_interval",
        "albedo",
        "albedo_interval",
        "correlation",
        "covariance",
        "dictionary_share",
        "error",
        "g",
        "g_interval",
        "likelihood",
        "measurement_noise",
        "misfit",
        "reduced_scattering_interval",
        "resolved",
        "resolved_at_g",
        "sample_ior",
        "sigma_t_interval",
        "sigma_t_per_mm",
        "suspicion",
        "thicknesses",
        "valley",
    ];
    assert_eq!(keys(&channel["refined"]), expected);
    let candidates = &fit["materials"][0]["channels"][0]["candidates"];
    assert_eq!(candidates.as_array().unwrap().len(), 2);
    let expected = ["albedo", "error", "g", "sample_ior", "sigma_t_per_mm", "thicknesses"];
    assert_eq!(keys(&candidates[0]), expected);
    let expected = ["gradient_rms", "record", "thickness_mm", "value_rms"];
    assert_eq!(keys(&candidates[0]["thicknesses"][1]), expected);

    let ask = |verb: &[&str]| run(dir, &[verb, &["m.csv", "--dictionary", "grid", "--json"][..]].concat());
    let scale = json(&ask(&["scale"]), "scale");
    assert_eq!(keys(&scale), with(&["common", "materials", "notes", "scale"]));
    let expected = ["at_end", "best_g", "by_g", "curvature", "curve", "error", "mu", "std_error"];
    assert_eq!(keys(&scale["scale"]), expected);
    assert_eq!(scale["scale"]["curve"].as_array().unwrap().len(), 301);
    let measure = json(&ask(&["measure"]), "measure");
    assert_eq!(keys(&measure), with(&["common", "common_g", "materials", "notes", "scale"]));
    // The dictionary has a single anisotropy, so none was chosen.
    assert_eq!((&measure["common_g"], &measure["common"]["g_interval"]), (&value!(0.4), &Value::Null));
    let map = json(&ask(&["map"]), "map");
    assert_eq!(keys(&map), with(&["maps", "notes"]));
    let expected = ["albedo", "best_layer", "channel", "layers", "material", "sample_ior", "sigma_t_per_mm"];
    assert_eq!(keys(&map["maps"][0]), expected);
    assert_eq!(keys(&map["maps"][0]["layers"][0]), ["best", "errors", "g", "similar"]);
    let similar = ["similar", "--sigma-t", "6", "--albedo", "0.9", "--g", "0.4", "--to", "0,0.8", "--json"];
    let similar = json(&run(dir, &similar), "similar");
    assert_eq!(keys(&similar), ["medium", "similar"]);
    assert!((similar["similar"][0]["sigma_t_per_mm"].as_f64().unwrap() - 3.84).abs() < 1e-9);
}

/// A measurement of simulated slabs, one of them a mixture of the two others in equal parts.
fn chart(dir: &Path) -> String {
    let media = [("pale", 4.8, 0.995), ("dark", 5.2, 0.92), ("both", 5.0, 0.956)];
    let mut all = String::new();
    for (material, sigma_t, albedo) in media {
        let medium =
            format!("simulate --sigma-t {sigma_t} --albedo {albedo} --g 0.4 --thickness 0.5,1 --scene paper");
        let slab = format!("{medium} --walks 20000 --seed 7 --noise 0 --measurement {material}");
        let ran = run(dir, &slab.split(' ').collect::<Vec<_>>());
        let rows = ran.stdout.lines().filter(|line| !line.starts_with('#'));
        all.extend(rows.skip(usize::from(!all.is_empty())).map(|line| format!("{line}\n")));
    }
    all
}

/// Mixtures give the media of their inks, as text and as JSON.
#[test]
fn mixtures_give_their_inks() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "chart.csv", &chart(dir));
    write(dir, "mix.toml", "[[mixture]]\nmaterial = \"both\"\nparts = { pale = 0.5, dark = 0.5 }\n");
    let command = ["measure", "chart.csv", "--dictionary", "grid", "--mixtures", "mix.toml", "--mu", "1"];
    let text = run(dir, &command);
    assert!(
        text.stdout.contains("inks, from all their mixtures together"),
        "{} {}",
        text.stdout,
        text.stderr
    );
    let data = json(&run(dir, &[&command[..], &["--json"]].concat()), "measure");
    let inks = &data["unmixed"]["inks"];
    assert_eq!(keys(&data["unmixed"]), ["common", "inks", "mixtures"]);
    let dark = inks.as_array().unwrap().iter().find(|i| i["material"] == "dark").unwrap();
    let interval = &dark["channels"][0]["absorption_interval"];
    let (low, high) = (interval["low"].as_f64().unwrap(), interval["high"].as_f64().unwrap());
    // 0.416 / mm; with the dictionary's two albedos it is determined to a factor of 2.
    assert!(low < high && low > 0.2 && high < 1.0, "{interval}");
    write(dir, "mix.toml", "[[mixture]]\nmaterial = \"grey\"\nparts = { pale = 0.5, dark = 0.5 }\n");
    fails(dir, &command, &["mixture.material", "grey", "both"]);
}

/// A design predicts the errors that sets of slabs would give.
#[test]
fn design_predicts_the_slab_errors() {
    let farm = farm();
    let dir = farm.path();
    let medium = ["--sigma-t", "5", "--albedo", "0.99", "--g", "0.4"];
    let command = [&["design", "--dictionary", "grid"][..], &medium].concat();
    let text = run(dir, &command);
    assert_eq!(text.code, 0, "{}", text.stderr);
    let data = json(&run(dir, &[&command[..], &["--json"]].concat()), "design");
    let sets = data["sets"].as_array().unwrap();
    let width = |set: &Value| set["g_held"]["sigma_t_per_mm"].as_f64();
    let one = sets.iter().find(|s| s["slabs_mm"] == value!([0.5]) && s["shots"] == 1).unwrap();
    let both = sets.iter().find(|s| s["slabs_mm"] == value!([0.5, 1.0])).unwrap();
    assert!(width(both).unwrap() < width(one).unwrap(), "{one} {both}");
    assert_eq!(run(dir, &[&command[..], &["--plot", "design.svg"]].concat()).code, 0);
    assert!(std::fs::read(dir.join("design.svg")).unwrap().starts_with(b"<svg"));
    let dark = [&["design", "--dictionary", "grid"][..], &["--sigma-t", "5", "--albedo", "2", "--g", "0.4"]]
        .concat();
    fails(dir, &dark, &["albedo"]);
}
