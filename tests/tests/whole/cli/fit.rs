//! The commands that fit: set-up, JSON shapes, mixtures, designs.

use std::path::Path;

use farm_tests::cli::{HEAD, fails, fails_line, farm, json, keys, rows, run_line, write};
use farm_tests::process::{farmctl, run};
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
        let options = "--session session.json --slope-std-error 0 --objective paper";
        let data = json(&run_line(dir, &format!("{verb} m.csv --dictionary grid --json {options}")), verb);
        let numbers = ["gain_std_error", "slope_std_error", "blur_std_error_mm", "origin_std_error_mm"];
        assert_eq!(numbers.map(|n| data[n].as_f64().unwrap()), [0.01, 0.0, 0.001, 0.05], "{verb}");
        assert_eq!(data["objective"], "paper", "{verb}");
        assert_eq!(
            data["assumed"],
            value!(["origin_std_error_mm", "offset_std_error", "wedge_std_error"]),
            "{verb}"
        );
    }
}

/// A measurement of simulated slabs, one of them a mixture of the two others in equal parts.
fn chart(dir: &Path) -> String {
    let media = [("pale", 4.8, 0.995), ("dark", 5.2, 0.92), ("both", 5.0, 0.956)];
    let mut all = String::new();
    for (material, sigma_t, albedo) in media {
        let medium =
            format!("simulate --sigma-t {sigma_t} --albedo {albedo} --g 0.4 --thickness 0.5,1 --scene paper");
        let slab = format!("{medium} --walks 20000 --seed 7 --noise 0 --measurement {material}");
        let ran = run_line(dir, &slab);
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
        text.stdout.contains("Inks, from all their mixtures together"),
        "{} {}",
        text.stdout,
        text.stderr
    );
    let data = json(&run(dir, &[&command[..], &["--json"]].concat()), "measure");
    let inks = &data["unmixed"]["inks"];
    assert_eq!(keys(&data["unmixed"]), ["common", "inks", "mixtures"]);
    // The dictionary has a single anisotropy, so none was chosen.
    assert_eq!((&data["common_g"], &data["common"]["g_interval"]), (&value!(0.4), &Value::Null));
    let dark = inks.as_array().unwrap().iter().find(|i| i["material"] == "dark").unwrap();
    let interval = &dark["channels"][0]["absorption_interval"];
    let (low, high) = (interval["low"].as_f64().unwrap(), interval["high"].as_f64().unwrap());
    // 0.416 / mm; with the dictionary's two albedos it is determined to a factor of 2.
    assert!(low < high && low > 0.2 && high < 1.0, "{interval}");
    write(dir, "mix.toml", "[[mixture]]\nmaterial = \"grey\"\nparts = { pale = 0.5, dark = 0.5 }\n");
    fails(dir, &command, &["mixture.material", "grey", "both"]);
}

/// Answers have the same bits on processors without fused multiplication, as a setting of the C library imitates them.
#[test]
fn answers_are_the_same_on_older_processors() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "chart.csv", &chart(dir));
    for line in [
        "measure chart.csv --dictionary grid --json",
        "measure chart.csv --dictionary grid --json --objective paper",
        "scale chart.csv --dictionary grid --json",
        "design --dictionary grid --sigma-t 5 --albedo 0.99 --g 0.4 --json",
    ] {
        let words: Vec<&str> = line.split_whitespace().collect();
        let mut older = farmctl(dir);
        older.args(&words).env("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2");
        let older = older.output().unwrap();
        let here = run(dir, &words);
        assert_eq!(here.code, 0, "{line}: {}", here.stderr);
        assert!(here.stdout == String::from_utf8_lossy(&older.stdout), "{line}: other digits");
    }
}

/// A design compares sets of slabs, and is drawn.
#[test]
fn design_predicts_the_slab_errors() {
    let farm = farm();
    let dir = farm.path();
    let command = "design --dictionary grid --sigma-t 5 --albedo 0.99 --g 0.4";
    let text = run_line(dir, &format!("{command} --plot design.svg"));
    assert_eq!(text.code, 0, "{}", text.stderr);
    assert!(std::fs::read(dir.join("design.svg")).unwrap().starts_with(b"<svg"));
    let data = json(&run_line(dir, &format!("{command} --json")), "design");
    let sets = data["sets"].as_array().unwrap();
    let width = |set: &Value| set["g_held"]["sigma_t_per_mm"].as_f64();
    let one = sets.iter().find(|s| s["slabs_mm"] == value!([0.5]) && s["shots"] == 1).unwrap();
    let both = sets.iter().find(|s| s["slabs_mm"] == value!([0.5, 1.0])).unwrap();
    assert!(width(both).unwrap() < width(one).unwrap(), "{one} {both}");
    fails_line(dir, "design --dictionary grid --sigma-t 5 --albedo 2 --g 0.4", &["albedo"]);
}
