//! `farmctl` as a user meets it: output, JSON shapes, exit codes, and how commands get along.

use std::path::Path;
use std::process::Command;

use farm_tests::cli::{GRID, HEAD, fails, farm, folder, json, keys, rows, write};
use farm_tests::process::{Process, Ran, farmctl, program, run};
use serde_json::{Value, json as value};

#[test]
fn every_verb_tells_its_result_in_one_stable_json_shape() {
    let farm = farm();
    let dir = farm.path();
    let dictionary = [
        "created_unix_ms",
        "eta_s",
        "failed_jobs",
        "goes_first",
        "grid_digest",
        "jobs_done",
        "jobs_leased",
        "jobs_total",
        "name",
        "priority",
        "reason",
        "records_digest",
        "records_done",
        "records_reused",
        "records_total",
        "state",
        "walks_max",
        "walks_min",
        "work_done",
    ];
    let submit = json(&run(dir, &["submit", "grid.toml", "--json"]), "submit");
    assert_eq!(keys(&submit), dictionary);
    assert_eq!((submit["state"].as_str(), submit["records_done"].as_u64()), (Some("done"), Some(8)));

    let list = json(&run(dir, &["list", "--json"]), "list");
    assert_eq!(keys(&list["dictionaries"][0]), dictionary);

    let status = json(&run(dir, &["status", "--json"]), "status");
    let expected = [
        "address",
        "checks_agreed",
        "checks_disputed",
        "database_bytes",
        "dictionaries",
        "jobs_done",
        "jobs_leased",
        "jobs_pending",
        "physics_version",
        "store_fault",
        "uptime_ms",
        "version",
        "workers",
    ];
    assert_eq!(keys(&status), expected);

    let show = json(&run(dir, &["show", "grid", "--json"]), "show");
    let expected = [
        "albedo",
        "derivatives",
        "g",
        "sample_ior",
        "scene",
        "seed",
        "sigma_t_per_mm",
        "thickness_mm",
        "walks",
    ];
    assert_eq!(keys(&show["grid"]), expected);

    let medium = ["--sigma-t", "6", "--albedo", "0.9", "--g", "0.4", "--thickness", "0.5"];
    let small = ["--walks", "5000", "--pixels", "12", "--json"];
    let simulate = json(&run(dir, &[&["simulate"][..], &medium, &small].concat()), "simulate");
    assert_eq!(keys(&simulate), ["channels", "seed", "walks", "x_mm"]);
    assert_eq!(keys(&simulate["channels"][2]), ["channel", "std_errors", "values"]);

    let one = ["export", "grid", "--json", "--sigma-t", "6", "--albedo", "0.9", "--thickness", "0.5"];
    let export = json(&run(dir, &one), "record");
    let expected = ["albedo", "channels", "g", "record", "sample_ior", "sigma_t_per_mm", "thickness_mm"];
    assert_eq!(keys(&export), expected);

    let error = run(dir, &["show", "none", "--json"]);
    assert_eq!(error.code, 1);
    assert!(json(&error, "error")["message"].as_str().unwrap().contains("dictionary none does not exist"));
}

#[test]
fn simulate_gives_the_profile_that_the_dictionary_holds_for_any_number_of_threads() {
    let farm = farm();
    let dir = farm.path();
    let simulate = |threads: &str| {
        let args = "simulate --sigma-t 6 --albedo 0.999 --g 0.4 --thickness 1 --walks 5000 --threads";
        let args: Vec<&str> = args.split(' ').chain([threads]).collect();
        run(dir, &args).stdout
    };
    let one = simulate("1");
    assert_eq!(one, simulate("3"));
    assert!(one.starts_with("channel,x_mm,value,std_error\nR,-4.98611"), "{one}");
    assert_eq!(one.lines().count(), 1 + 3 * 360);
    let selected = ["export", "grid", "--sigma-t", "6", "--albedo", "0.999", "--thickness", "1"];
    let exported = run(dir, &selected).stdout;
    let columns = |line: &str| line.splitn(7, ',').nth(6).map(ToOwned::to_owned);
    let exported: Vec<_> = exported.lines().skip(1).filter_map(columns).collect();
    assert_eq!(exported, one.lines().skip(1).collect::<Vec<_>>());
}

#[test]
fn reflectances_on_the_command_line_make_one_channel() {
    let dir = folder();
    let args = "simulate --sigma-t 6 --albedo 0.9 --g 0 --thickness 0.5 --scene smooth --walks 5000 --pixels 4 \
                --width 2 --rho-light 0.9 --rho-dark 0.1";
    let ran = run(dir.path(), &args.split_whitespace().collect::<Vec<_>>());
    let x: Vec<_> =
        ran.stdout.lines().skip(1).map(|l| l.split(',').take(2).collect::<Vec<_>>().join(" ")).collect();
    assert_eq!(x, ["mono -0.75", "mono -0.25", "mono 0.25", "mono 0.75"]);
}

#[test]
fn a_second_command_joins_the_farm_that_is_running() {
    let dir = folder();
    // Some seconds of work, so that the farm is there to be joined.
    write(dir.path(), "long.toml", &GRID.replace("walks = 5000", "walks = 2500000"));
    let mut submit = farmctl(dir.path());
    submit.args(["submit", "long.toml", "-q"]);
    let mut submit = Process::spawn("farmctl", &mut submit, &dir.path().join("farmctl.log"));
    let joined = (0..100).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(50));
        let ran = run(dir.path(), &["status", "--json"]);
        (ran.code == 0).then(|| json(&ran, "status")).filter(|s| s["jobs_leased"] != 0)
    });
    let status = joined.expect("the running farm answers");
    assert!(status["address"].as_str().unwrap().starts_with("http://127.0.0.1:"));
    assert_eq!(status["workers"].as_array().unwrap().len(), 1);
    submit.kill();
}

#[test]
fn commands_in_one_folder_do_not_get_in_each_others_way() {
    let farm = farm();
    write(farm.path(), "m.csv", &(HEAD.to_owned() + &rows("R", 0.5)));
    let spawn = |args: &[&str]| {
        let mut command = farmctl(farm.path());
        command.args(args).stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        command.spawn().unwrap()
    };
    let fit = ["fit", "m.csv", "--dictionary", "grid", "--json"];
    let mut running: Vec<_> = (0..6).map(|_| spawn(&fit)).collect();
    // Two grids at a time, each with its own process, among commands that only ask.
    for name in ["a", "b"] {
        running.push(spawn(&["submit", "grid.toml", "--name", name, "--json"]));
    }
    let ran: Vec<Ran> = running.into_iter().map(|c| c.wait_with_output().unwrap().into()).collect();
    for fit in &ran[..6] {
        assert_eq!((fit.code, &fit.stdout), (0, &ran[0].stdout), "{}", fit.stderr);
    }
    for submit in &ran[6..] {
        assert_eq!(submit.code, 0, "{}", submit.stderr);
        assert_eq!(json(submit, "submit")["state"], "done");
    }
}

#[test]
fn every_question_takes_the_set_up_from_session_and_command_line() {
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
        let told = ["--session", "session.json", "--slope-std-error", "0", "--objective", "paper"];
        let ran = run(dir, &[&[verb, "m.csv", "--dictionary", "grid", "--json"][..], &told].concat());
        let data = json(&ran, verb);
        let numbers = ["gain_std_error", "slope_std_error", "blur_std_error_mm", "origin_std_error_mm"];
        assert_eq!(numbers.map(|n| data[n].as_f64().unwrap()), [0.01, 0.0, 0.001, 0.05], "{verb}");
        assert_eq!(data["objective"], "paper", "{verb}");
        assert_eq!(data["assumed"], value!(["origin_std_error_mm", "offset_std_error"]), "{verb}");
    }
}

#[test]
fn every_answer_of_the_fit_has_its_json_shape() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "m.csv", &(HEAD.to_owned() + &rows("R", 0.5) + &rows("R", 1.0)));
    let fit = json(&run(dir, &["fit", "m.csv", "--dictionary", "grid", "--json", "--top", "2"]), "fit");
    let options = [
        "albedo_range",
        "assumed",
        "blur_mm",
        "blur_std_error_mm",
        "dictionary",
        "g",
        "g_range",
        "gain_std_error",
        "lambda",
        "level",
        "mu",
        "mu_std_error",
        "objective",
        "offset_std_error",
        "origin_std_error_mm",
        "sigma_t_range",
        "slope_std_error",
        "thickness_std_error_mm",
        "wavelet",
    ];
    let with = |more: &[&str]| {
        let mut all: Vec<String> = options.iter().chain(more).map(|k| (*k).to_owned()).collect();
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
        "measurement_noise",
        "misfit",
        "reduced_scattering_interval",
        "resolved",
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
    // The dictionary has one anisotropy: there was nothing to choose.
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
        let medium = format!("simulate --sigma-t {sigma_t} --albedo {albedo} --g 0.4 --thickness 0.5,1");
        let slab = format!("{medium} --walks 20000 --seed 7 --measurement {material}");
        let ran = run(dir, &slab.split(' ').collect::<Vec<_>>());
        let rows = ran.stdout.lines().filter(|line| !line.starts_with('#'));
        all.extend(rows.skip(usize::from(!all.is_empty())).map(|line| format!("{line}\n")));
    }
    all
}

#[test]
fn mixtures_tell_of_their_inks() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "chart.csv", &chart(dir));
    write(dir, "mix.toml", "[[mixture]]\nmaterial = \"both\"\nparts = { pale = 0.5, dark = 0.5 }\n");
    let asked = ["measure", "chart.csv", "--dictionary", "grid", "--mixtures", "mix.toml", "--mu", "1"];
    let text = run(dir, &asked);
    assert!(
        text.stdout.contains("inks, from all their mixtures together"),
        "{} {}",
        text.stdout,
        text.stderr
    );
    let data = json(&run(dir, &[&asked[..], &["--json"]].concat()), "measure");
    let inks = &data["unmixed"]["inks"];
    assert_eq!(keys(&data["unmixed"]), ["common", "inks", "mixtures"]);
    let dark = inks.as_array().unwrap().iter().find(|i| i["material"] == "dark").unwrap();
    let interval = &dark["channels"][0]["absorption_interval"];
    let (low, high) = (interval["low"].as_f64().unwrap(), interval["high"].as_f64().unwrap());
    // 0.416 / mm; between the dictionary's two albedos it is known to a factor of 2.
    assert!(low < high && low > 0.2 && high < 1.0, "{interval}");
    write(dir, "mix.toml", "[[mixture]]\nmaterial = \"grey\"\nparts = { pale = 0.5, dark = 0.5 }\n");
    fails(dir, &asked, &["mixture.material", "grey", "both"]);
}

#[test]
fn a_design_tells_what_slabs_would_give() {
    let farm = farm();
    let dir = farm.path();
    let medium = ["--sigma-t", "5", "--albedo", "0.99", "--g", "0.4"];
    let asked = [&["design", "--dictionary", "grid"][..], &medium].concat();
    let text = run(dir, &asked);
    assert_eq!(text.code, 0, "{}", text.stderr);
    let data = json(&run(dir, &[&asked[..], &["--json"]].concat()), "design");
    let sets = data["sets"].as_array().unwrap();
    let width = |set: &Value| set["g_held"]["sigma_t_per_mm"].as_f64();
    let one = sets.iter().find(|s| s["slabs_mm"] == value!([0.5]) && s["shots"] == 1).unwrap();
    let both = sets.iter().find(|s| s["slabs_mm"] == value!([0.5, 1.0])).unwrap();
    assert!(width(both).unwrap() < width(one).unwrap(), "{one} {both}");
    assert_eq!(run(dir, &[&asked[..], &["--plot", "design.svg"]].concat()).code, 0);
    assert!(std::fs::read(dir.join("design.svg")).unwrap().starts_with(b"<svg"));
    let dark = [&["design", "--dictionary", "grid"][..], &["--sigma-t", "5", "--albedo", "2", "--g", "0.4"]]
        .concat();
    fails(dir, &dark, &["albedo"]);
}

#[test]
fn an_interrupted_submission_says_so_and_goes_on_later() {
    let dir = folder();
    write(dir.path(), "long.toml", &GRID.replace("walks = 5000", "walks = 1500000"));
    let submit = farmctl(dir.path())
        .args(["submit", "long.toml"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let pid = submit.id().to_string();
    std::thread::sleep(std::time::Duration::from_millis(700));
    assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
    let ran: Ran = submit.wait_with_output().unwrap().into();
    assert_eq!(ran.code, 130, "{}", ran.stdout);
    assert!(ran.stdout.contains("submit again to go on"), "{}", ran.stdout);
    assert_eq!(run(dir.path(), &["submit", "long.toml", "-q"]).code, 0);
}

#[test]
fn export_writes_a_file_whole_and_stops_quietly_when_its_reader_goes() {
    let farm = farm();
    let file = farm.path().join("out.csv");
    assert_eq!(run(farm.path(), &["export", "grid", "-o", "out.csv"]).code, 0);
    let text = std::fs::read_to_string(&file).unwrap();
    assert_eq!(text.lines().count(), 1 + 8 * 3 * 360);
    assert!(!farm.path().join("out.csv.partial").exists());
    fails(farm.path(), &["export", "grid", "--g", "0.5"], &["g = 0.5 is not valid: the dictionary has 0.4"]);
    let piped = Command::new("sh")
        .current_dir(farm.path())
        .args(["-c", "\"$0\" export grid | head -1", program("farmctl").to_str().unwrap()])
        .output()
        .unwrap();
    assert_eq!(String::from_utf8_lossy(&piped.stderr), "");
}

#[test]
fn pictures_and_media_are_written() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "m.csv", &(HEAD.to_owned() + &rows("R", 0.5) + &rows("R", 1.0)));
    let asked = ["m.csv", "--dictionary", "grid"];
    let medium = ["--sigma-t", "6", "--albedo", "0.9", "--g", "0.4", "--thickness", "0.5", "--walks", "5000"];
    for (verb, arguments, file) in [
        ("fit", &asked[..], "fit.svg"),
        ("fit", &asked[..], "fit.png"),
        ("scale", &asked[..], "scale.svg"),
        ("map", &asked[..], "map.png"),
        ("measure", &asked[..], "measure.svg"),
        ("show", &["grid"][..], "show.svg"),
        ("simulate", &medium[..], "changes.svg"),
    ] {
        let ran = run(dir, &[&[verb][..], arguments, &["--plot", file]].concat());
        assert_eq!(ran.code, 0, "{verb}: {}", ran.stderr);
        let bytes = std::fs::read(dir.join(file)).unwrap();
        let head: &[u8] = if file.ends_with("svg") { b"<svg" } else { b"\x89PNG" };
        assert!(bytes.starts_with(head) && bytes.len() > 5_000, "{file}: {} bytes", bytes.len());
    }
    assert_eq!(run(dir, &[&["measure"][..], &asked, &["-o", "out"]].concat()).code, 0);
    for (file, text) in [
        ("table.csv", "material,channel,sigma_t_per_mm,"),
        ("media.py", "\"type\": \"homogeneous\""),
        ("media.xml", "<medium type=\"homogeneous\""),
        ("media.pbrt", "MakeNamedMedium"),
    ] {
        assert!(std::fs::read_to_string(dir.join("out").join(file)).unwrap().contains(text), "{file}");
    }
    fails(dir, &[&["fit"][..], &asked, &["--plot", "fit.pdf"]].concat(), &["fit.pdf", ".svg or .png"]);
    assert!(!dir.join("fit.pdf").exists());
}

#[test]
fn help_and_completions_are_there() {
    let dir = folder();
    let help = run(dir.path(), &["--help"]);
    assert_eq!(help.code, 0);
    for verb in [
        "submit",
        "fit",
        "scale",
        "measure",
        "map",
        "design",
        "similar",
        "simulate",
        "status",
        "list",
        "show",
        "export",
        "completions",
    ] {
        assert!(help.stdout.contains(verb), "{verb}");
        assert_eq!(run(dir.path(), &[verb, "--help"]).code, 0, "{verb}");
    }
    for shell in ["bash", "zsh", "fish"] {
        assert!(run(dir.path(), &["completions", shell]).stdout.contains("farmctl"), "{shell}");
    }
    assert_eq!(run(dir.path(), &["frobnicate"]).code, 2);
}
