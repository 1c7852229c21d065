//! Predictions of prints: against the tracer, charts, recipes and comparisons, from a media file.

use std::fmt::Write as _;
use std::path::Path;

use farm_tests::cli::{fails, fails_line, folder, json, write};
use farm_tests::photograph::{EXAMPLE_NM, SpectralMaterial};
use farm_tests::process::run;
use optics_model::SceneFile;
use optics_model::scene::{Channel, Scene};
use serde_json::{Value, json as value};

/// White and magenta in eight bands, with standard errors of 1 % in σ_t and of 3 % in √(1 − α).
fn media(change: f64) -> Value {
    let channels = EXAMPLE_NM.map(|nm| Channel::new(nm.to_string(), 0.95, 0.03).unwrap()).to_vec();
    let scene = Scene::lab().with_channels(channels).unwrap();
    let interval = |v: f64| value!({"low": 0.98 * v, "high": 1.02 * v});
    let channel = |material: &SpectralMaterial, nm: f64| {
        let m = material.at(nm);
        let (sigma_t, albedo, g) = (change * m.sigma_t_per_mm(), m.albedo(), m.g());
        let root = (1.0 - albedo).sqrt();
        value!({
            "channel": nm.to_string(), "sigma_t_per_mm": sigma_t, "albedo": albedo, "g": g, "sample_ior": 1.53,
            "covariance": [[1e-4, 0.0, 0.0], [0.0, (0.03 * root).powi(2), 0.0], [0.0, 0.0, 0.0]],
            "resolved": true, "misfit": 1.0, "sigma_t_interval": interval(sigma_t), "albedo_interval": interval(albedo),
            "g_interval": interval(g), "reduced_scattering_interval": interval(sigma_t * albedo * (1.0 - g)),
            "absorption_interval": interval(sigma_t * (1.0 - albedo)),
        })
    };
    let material = |m: &SpectralMaterial| value!({"material": m.name, "channels": EXAMPLE_NM.map(|nm| channel(m, nm)).to_vec()});
    value!({
        "format": "farmctl-media/1", "program": "test", "dictionary": "d", "dictionary_digest": "0", "mu": 1.0,
        "mu_std_error": 0.0, "scene": SceneFile::from(&scene),
        "materials": SpectralMaterial::ALL[..2].iter().map(material).collect::<Vec<_>>(),
    })
}

fn prepared() -> tempfile::TempDir {
    let folder = folder();
    write(folder.path(), "media.json", &media(1.0).to_string());
    folder
}

/// A polished print, whose faces need few directions.
const POLISHED: [&str; 4] = ["--geometry", "45:0", "--roughness", "0"];

fn predicted(folder: &Path, args: &[&str]) -> Value {
    let ran = run(folder, &[&["predict", "media.json", "--json"], args].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    json(&ran, "predict")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// A chart of what is predicted validates its inks; one with other inks contradicts the one that differs.
#[test]
fn charts_validate_their_inks() {
    let folder = prepared();
    write(
        folder.path(),
        "chart.toml",
        "[[mixture]]\nmaterial = 'pink'\nparts = { white = 0.9, magenta = 0.1 }\n",
    );
    let chart = |factor: f64| {
        let mut rows = "material,channel,thickness_mm,x_mm,value,std_error\n".to_owned();
        for (name, slab) in
            [("white", "white:1"), ("magenta", "magenta:1"), ("pink", "white=0.9,magenta=0.1:1")]
        {
            let data = predicted(folder.path(), &[&[slab, "--over", "light"][..], &POLISHED].concat());
            for channel in data["channels"].as_array().unwrap() {
                let shift = if name == "magenta" { factor } else { 1.0 };
                let value = shift * number(&channel["bases"][0]["radiance_factor"]);
                _ = writeln!(
                    rows,
                    "{name},{},1,,{value},{}",
                    channel["channel"].as_str().unwrap(),
                    2e-3 * value
                );
            }
        }
        write(folder.path(), "chart.csv", &rows);
        let args = ["validate", "media.json", "chart.csv", "--mixtures", "chart.toml", "--json"];
        let ran = run(folder.path(), &[&args[..], &POLISHED].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        json(&ran, "validate")
    };
    let good = chart(1.0);
    assert_eq!(good["patches"].as_array().unwrap().len(), 24);
    assert!(number(&good["chi2"]) < 1e-6, "{}", good["chi2"]);
    assert!(good["colours"].as_array().unwrap().iter().all(|c| number(&c["delta_e_2000"]) < 1e-6));
    let wrong = chart(1.3);
    let ink_z = |name: &str| {
        number(&wrong["inks"].as_array().unwrap().iter().find(|i| i["material"] == name).unwrap()["z"])
    };
    assert!(ink_z("magenta") > 3.0 && ink_z("white").abs() < 1.0, "{}", wrong["inks"]);
    let message = "patch \"pink\": neither measured nor a mixture";
    fails_line(folder.path(), "validate media.json chart.csv", &[message]);
}

/// The colour of a mixture leads back to the mixture.
#[test]
fn recipes_find_the_mixture() {
    let folder = prepared();
    let slab = ["white=0.85,magenta=0.15:1", "--over", "white"];
    let data = predicted(folder.path(), &[&slab[..], &POLISHED].concat());
    let lab = &data["colours"]["bases"][0]["lab"];
    let target: Vec<String> = (0..3).map(|k| number(&lab[k]).to_string()).collect();
    let recipe = |more: &[&str]| {
        let target = target.join(",");
        let args = ["recipe", "media.json", "--thickness", "1", "--json", "--target", &target];
        let ran = run(folder.path(), &[&args[..], more, &POLISHED].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        json(&ran, "recipe")["recipes"][0].clone()
    };
    let found = recipe(&[]);
    let share = |found: &Value| {
        number(&found["shares"].as_array().unwrap().iter().find(|s| s["ink"] == "magenta").unwrap()["share"])
    };
    assert!((share(&found) - 0.15).abs() < 2e-3 && number(&found["difference"]) < 0.1, "{found}");
    let limited = recipe(&["--most", "magenta=0.05"]);
    assert!((share(&limited) - 0.05).abs() < 1e-9 && limited["limited_by"][0] == "magenta", "{limited}");
}

/// A measurement agrees with itself, and differs from one whose σ_t is 10 % larger.
#[test]
fn comparisons_count_differences() {
    let folder = prepared();
    write(folder.path(), "other.json", &media(1.1).to_string());
    let compared = |other: &str| {
        let ran = run(folder.path(), &["compare", "media.json", other, "--json"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        json(&ran, "compare")["channels"].as_array().unwrap().clone()
    };
    // A library is searched by content: the same media are nearest, whatever their names are.
    std::fs::create_dir_all(folder.path().join("library/deep")).unwrap();
    for (place, change) in [("library", 1.0), ("library/deep", 1.3)] {
        let name = format!("{place}/{change}");
        std::fs::create_dir_all(folder.path().join(&name)).unwrap();
        write(folder.path(), &format!("{name}/media.json"), &media(change).to_string());
    }
    let ran = run(folder.path(), &["compare", "media.json", "library", "--json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let matches = &json(&ran, "compare")["library"][0];
    assert_eq!((&matches["material"], matches["nearest"].as_array().unwrap().len()), (&value!("white"), 4));
    let [first, second] = [0, 1].map(|i| &matches["nearest"][i]);
    assert_eq!((&first["folder"], &first["material"]), (&value!("1"), &value!("white")));
    assert_eq!(number(&first["difference_percent"]), 0.0);
    assert!(number(&second["difference_percent"]) > 10.0, "{second}");
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    fails(folder.path(), &["compare", "media.json", "empty"], &["empty: neither media.json nor a folder"]);
    let same = compared("media.json");
    assert_eq!(same.len(), 16);
    assert!(same.iter().all(|c| number(&c["probability"]) > 0.999));
    let other = compared("other.json");
    let e_n = |c: &Value, name: &str| {
        number(&c["quantities"].as_array().unwrap().iter().find(|q| q["quantity"] == name).unwrap()["e_n"])
    };
    assert!(other.iter().all(|c| number(&c["probability"]) < 1e-6 && e_n(c, "σ_t") < -2.0), "{:?}", other[0]);
}

/// The tag has the colour of the answer, over the last base.
#[test]
fn tags_have_the_predicted_colour() {
    let folder = prepared();
    let args = ["magenta:2", "--over", "black,white", "--tag", "magenta.yaml"];
    let data = predicted(folder.path(), &[&args[..], &POLISHED].concat());
    let srgb = data["colours"]["bases"][1]["srgb"].as_array().unwrap();
    let hex: String = srgb.iter().map(|v| format!("{:02x}", v.as_u64().unwrap())).collect();
    let lab = data["colours"]["bases"][1]["lab"].as_array().unwrap().iter().map(number);
    let lab = lab.map(|v| format!("{v:.2}")).collect::<Vec<_>>().join(", ");
    let text = std::fs::read_to_string(folder.path().join("magenta.yaml")).unwrap();
    let expected = format!(
        "# \"magenta 2 mm\" over white, a bare print at 45:0: predicted from measured media\ndata:\n  main:\n    \
         material_class: SLA\n    material_name: \"magenta\"\n    primary_color: \"#{hex}\"\n    \
         # predicted, D50, 2°, a bare print at 45:0; the standard allows it for D65 and 2° if it is measured\n    \
         # primary_color_lab: [{lab}]\n"
    );
    assert_eq!(text, expected);
}

#[test]
fn wrong_prints_are_refused() {
    let folder = prepared();
    let dir = folder.path();
    for (line, parts) in [
        ("predict media.json cyan:1", &["material \"cyan\" is not in the file: it has white, magenta"][..]),
        ("predict media.json white:1 --over 2", &["over = 2 is not valid: allowed are black"]),
        ("predict media.json white:1 --roughness 0.1", &["give --geometry 45:0 or d:8"]),
        (
            "recipe media.json --thickness 1 --target nothing",
            &["target nothing: it is neither L*,a*,b* nor a file"],
        ),
    ] {
        fails_line(dir, line, parts);
    }
    let mut two_indices = media(1.0);
    let channel = &mut two_indices["materials"][1]["channels"][0];
    let name = channel["channel"].as_str().unwrap().to_owned();
    channel["sample_ior"] = 1.49.into();
    write(dir, "media.json", &two_indices.to_string());
    let white = format!("{name}: white was measured with the index 1.5");
    let parts = [&white, "magenta with 1.49; a print has one"];
    fails_line(dir, "predict media.json white:1 magenta:1", &parts);
}

/// Stacks that look as predicted validate their media; others, and options of profiles, are refused by name.
#[test]
fn stacks_validate_their_media() {
    let folder = prepared();
    let mut chart = "slabs,channel,value\n".to_owned();
    for stack in
        [&["white:0.4"][..], &["magenta:0.1", "white:0.8"], &["white:0.1", "magenta:0.1", "white:0.8"]]
    {
        let found = predicted(folder.path(), &[stack, &POLISHED, &["--over", "0.5"]].concat());
        for channel in found["channels"].as_array().unwrap() {
            let value = number(&channel["bases"][0]["radiance_factor"]);
            let name = channel["channel"].as_str().unwrap();
            writeln!(chart, "{},{name},{value:.6}", stack.join(" ")).unwrap();
        }
    }
    write(folder.path(), "stacks.csv", &chart);
    let validate =
        [&["validate", "media.json", "stacks.csv", "--over", "0.5", "--json"], &POLISHED[..]].concat();
    let ran = run(folder.path(), &validate);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let found = json(&ran, "validate_stacks");
    assert!(found["patches"] == 3 && number(&found["greatest"]) < 1e-4, "{found}");
    let passed: Vec<String> = chart.lines().skip(1).map(|row| format!("{row},transmission\n")).collect();
    write(folder.path(), "passed.csv", &format!("slabs,channel,value,geometry\n{}", passed.concat()));
    fails_line(folder.path(), "validate media.json passed.csv", &["only reflected light is validated"]);
    write(folder.path(), "other.csv", &chart.replace("magenta", "violet"));
    fails_line(folder.path(), "validate media.json other.csv", &["material \"violet\" is not in the file"]);
    fails_line(folder.path(), "measure stacks.csv --mu 1", &["--mu belongs to profiles over an edge"]);
    fails_line(folder.path(), "measure stacks.csv --g 0.2..0.4", &["give one value, as --g 0.4"]);
    fails_line(folder.path(), "chart white -o out", &["a chart of 1 materials is not valid"]);
    fails_line(folder.path(), "chart white cyan --base red:1 -o out", &["--base red", "white, cyan"]);
}

/// A chart's patches are predicted for the geometry of each, over a base with a reflectance for each channel.
#[test]
fn patches_have_their_geometry_and_base() {
    let folder = prepared();
    let mut chart = "slabs,channel,value,geometry\n".to_owned();
    let rho = |i: usize| 0.2 + 0.1 * i as f64;
    for geometry in ["45:0", "d:8"] {
        let over = (0..EXAMPLE_NM.len()).map(|i| rho(i).to_string()).collect::<Vec<_>>().join(",");
        let args = ["magenta:0.3", "--geometry", geometry, "--roughness", "0", "--over", &over];
        let found = predicted(folder.path(), &args);
        for (i, nm) in EXAMPLE_NM.iter().enumerate() {
            let value = number(&found["channels"][i]["bases"][i]["radiance_factor"]);
            writeln!(chart, "magenta:0.3,{nm},{value:.6},{geometry}").unwrap();
        }
    }
    write(folder.path(), "stacks.csv", &chart);
    let base = |count: usize| {
        let all = (0..count).map(|i| format!("{} = {}", EXAMPLE_NM[i], rho(i))).collect::<Vec<_>>();
        format!("values = \"stacks.csv\"\nbase = {{ {} }}\n", all.join(", "))
    };
    write(folder.path(), "all.toml", &base(EXAMPLE_NM.len()));
    let ran = run(folder.path(), &["validate", "media.json", "all.toml", "--roughness", "0", "--json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let found = json(&ran, "validate_stacks");
    assert!(found["patches"] == 2 && number(&found["greatest"]) < 1e-4, "{found}");
    assert_eq!(found["geometry"], "45:0, d:8");
    write(folder.path(), "some.toml", &base(2));
    let parts = ["base: no reflectance for channel ", "0, nor for all"];
    fails_line(folder.path(), "validate media.json some.toml", &parts);
}
