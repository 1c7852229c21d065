//! `farmctl` as a user meets it: output, JSON shapes, errors, exit codes, and what is left on the disk.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

use farm_tests::process::{Ran, farmctl, program, run};
use serde_json::Value;

const GRID: &str = "sigma_t_per_mm = [4, 6]\nalbedo = [0.9, 0.999]\ng = [0.4]\nwalks = 5000\n";

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn write(folder: &Path, name: &str, text: &str) {
    std::fs::write(folder.join(name), text).unwrap();
}

/// A folder with the dictionary `grid`.
fn farm() -> tempfile::TempDir {
    let folder = folder();
    write(folder.path(), "grid.toml", GRID);
    let submitted = run(folder.path(), &["submit", "grid.toml"]);
    assert_eq!(submitted.code, 0, "{}", submitted.stderr);
    assert!(submitted.stdout.starts_with("grid: 8 records are done"), "{}", submitted.stdout);
    folder
}

fn json(ran: &Ran, kind: &str) -> Value {
    let value: Value = serde_json::from_str(&ran.stdout).unwrap_or_else(|e| panic!("{e}: {}", ran.stdout));
    assert_eq!(value["api"], "farmctl/1");
    assert_eq!(value["kind"], kind);
    value["data"].clone()
}

fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<_> = value.as_object().expect("an object").keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

/// A command that must fail with exit code 1, a message on standard error that holds `parts`, and no output.
fn fails(folder: &Path, args: &[&str], parts: &[&str]) {
    let ran = run(folder, args);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, ""), "{args:?}: {}", ran.stderr);
    assert!(ran.stderr.starts_with("farmctl: "), "{args:?}: {}", ran.stderr);
    for part in parts {
        assert!(ran.stderr.contains(part), "{args:?} should tell {part:?}: {}", ran.stderr);
    }
}

/// Rows of a profile that rises from 0.1 to 0.8.
fn rows(channel: &str, thickness: f64) -> String {
    let row = |i: i32| {
        let x = (f64::from(i) - 29.5) / 6.0;
        format!("resin,{channel},{thickness},{x:.5},{:.5}\n", 0.45 + 0.35 * x.tanh())
    };
    (0..60).map(row).collect()
}

const HEAD: &str = "material,channel,thickness_mm,x_mm,value\n";

#[test]
fn every_verb_tells_its_result_in_one_stable_json_shape() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "m.csv", &(HEAD.to_owned() + &rows("R", 0.5) + &rows("R", 1.0)));
    let dictionary = [
        "created_unix_ms",
        "failed_jobs",
        "grid_digest",
        "jobs_done",
        "jobs_leased",
        "jobs_total",
        "name",
        "records_digest",
        "records_done",
        "records_total",
        "state",
        "work_done",
    ];
    let submit = json(&run(dir, &["submit", "grid.toml", "--json"]), "submit");
    assert_eq!(keys(&submit), dictionary);
    assert_eq!((submit["state"].as_str(), submit["records_done"].as_u64()), (Some("done"), Some(8)));

    let list = json(&run(dir, &["list", "--json"]), "list");
    assert_eq!(keys(&list["dictionaries"][0]), dictionary);

    let status = json(&run(dir, &["status", "--json"]), "status");
    let expected =
        ["address", "dictionaries", "jobs_leased", "jobs_pending", "physics_version", "version", "workers"];
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

    let fit = json(&run(dir, &["fit", "m.csv", "--dictionary", "grid", "--json", "--top", "2"]), "fit");
    assert_eq!(keys(&fit), ["dictionary", "g", "lambda", "materials", "mu"]);
    let candidates = &fit["materials"][0]["channels"][0]["candidates"];
    assert_eq!(candidates.as_array().unwrap().len(), 2);
    let expected = ["albedo", "error", "g", "sample_ior", "sigma_t_per_mm", "thicknesses"];
    assert_eq!(keys(&candidates[0]), expected);
    let expected = ["gradient_rms", "record", "thickness_mm", "value_rms"];
    assert_eq!(keys(&candidates[0]["thicknesses"][1]), expected);

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
fn a_scene_file_describes_any_stack() {
    let dir = folder();
    let scene = |roughness: &str| {
        format!(
            "[sensor]\nwidth_mm = 4\npixels = 8\n[[channel]]\nname = 'K'\nrho_light = 0.8\nrho_dark = 0\n\
             [[layer]]\nname = 'resin'\nsample = true\nroughness = {roughness}\n"
        )
    };
    write(dir.path(), "scene.toml", &scene("0.1"));
    write(dir.path(), "bad.toml", &scene("-0.1"));
    let args = |scene: &'static str| {
        let rest = "--sigma-t 6 --albedo 0.9 --g 0 --thickness 0.5 --walks 5000 --scene";
        ["simulate"].into_iter().chain(rest.split(' ')).chain([scene]).collect::<Vec<_>>()
    };
    let ran = run(dir.path(), &args("scene.toml"));
    assert_eq!((ran.code, ran.stdout.lines().count()), (0, 9), "{}", ran.stderr);
    fails(dir.path(), &args("bad.toml"), &["bad.toml", "layer[0].roughness = -0.1 is not valid"]);
    fails(dir.path(), &args("none.toml"), &["\"none.toml\" is neither \"paper\" nor \"smooth\" nor a file"]);
}

#[test]
fn bad_parameters_are_refused_with_field_value_and_range() {
    let dir = folder();
    let with = |change: &[&'static str]| {
        let mut args = vec![
            "simulate",
            "--sigma-t",
            "6",
            "--albedo",
            "0.9",
            "--g",
            "0.4",
            "--thickness",
            "0.5",
            "--walks",
            "5000",
        ];
        match args.iter().position(|a| *a == change[0]) {
            Some(i) => args[i + 1] = change[1],
            None => args.extend(change),
        }
        args
    };
    for (change, message) in [
        (&["--g", "1"][..], "g = 1 is not valid: allowed are -0.999 to 0.999"),
        (&["--thickness", "-0.5"], "thickness_mm = -0.5 is not valid"),
        (&["--sigma-t", "NaN"], "sigma_t_per_mm = NaN is not valid"),
        (&["--albedo", "1.5"], "albedo = 1.5 is not valid: allowed are 0 to 1"),
        (&["--sample-ior", "0.5"], "sample_ior = 0.5 is not valid"),
        (&["--walks", "1000"], "walks = 1000 is not valid: allowed are multiples of 2500"),
        (&["--pixels", "0"], "pixels = 0 is not valid"),
        (&["--width", "inf"], "width_mm = inf is not valid"),
        (&["--rho-light", "2", "--rho-dark", "0"], "rho_light = 2 is not valid"),
    ] {
        fails(dir.path(), &with(change), &[message]);
    }
    let alone = run(dir.path(), &with(&["--rho-light", "0.9"]));
    assert_eq!(alone.code, 2, "{}", alone.stderr);
}

#[test]
fn bad_grids_are_refused_and_leave_nothing_behind() {
    let dir = folder();
    for (grid, message) in [
        ("sigma_t_per_mm = [1, nan]", "sigma_t_per_mm[1] = NaN is not valid"),
        ("g = [0.4, 1.0]", "g[1] = 1 is not valid"),
        ("thickness_mm = [-1]", "thickness_mm[0] = -1 is not valid"),
        ("albedo = [0.9, 0.5]", "albedo[1] = 0.5 is not valid: values must be strictly rising"),
        ("albedo = []", "albedo = 0 values is not valid"),
        ("walks = 100", "walks = 100 is not valid"),
        ("colour = 'red'", "unknown field `colour`"),
        ("g = [0.4", "TOML parse error"),
        ("scene = 'none.toml'", "neither \"paper\" nor \"smooth\" nor a file"),
        ("scene = { layers = [] }", "unknown field `layers`"),
        ("scene = { layer = [] }", "exactly one layer must be the sample"),
    ] {
        write(dir.path(), "bad.toml", grid);
        fails(dir.path(), &["submit", "bad.toml"], &["bad.toml", message]);
    }
    fails(dir.path(), &["submit", "none.toml"], &["grid file none.toml", "No such file"]);
    write(dir.path(), "grid.toml", GRID);
    fails(dir.path(), &["submit", "grid.toml", "--name", "../x"], &["name = \"../x\" is not valid"]);
    assert!(!dir.path().join("farm-data").exists(), "a refused submission must not make a data directory");
}

#[test]
fn bad_measurements_are_refused() {
    let farm = farm();
    let dir = farm.path();
    let good = rows("R", 0.5);
    for (text, message) in [
        ("material,channel,x_mm,value\n".to_owned() + &good, "missing column thickness_mm"),
        (HEAD.to_owned(), "no rows"),
        (HEAD.to_owned() + &good.replacen(",0.10004", ",NaN", 1), "value = NaN"),
        (HEAD.to_owned() + &good.replacen(",0.10004", ",black", 1), "is not a number"),
        (
            HEAD.to_owned() + &good.lines().rev().fold(String::new(), |t, l| t + l + "\n"),
            "x must be strictly rising",
        ),
        (HEAD.to_owned() + &rows("X", 0.5), "channel = X is not valid: the dictionary has R, G, B"),
        (HEAD.to_owned() + &rows("R", 0.7), "thickness_mm = 0.7 is not valid: the dictionary has 0.5, 1"),
    ] {
        write(dir, "m.csv", &text);
        fails(dir, &["fit", "m.csv", "--dictionary", "grid"], &[message]);
    }
    write(dir, "m.csv", &(HEAD.to_owned() + &good));
    fails(dir, &["fit", "none.csv"], &["measurement none.csv", "No such file"]);
    fails(dir, &["fit", "m.csv"], &["dictionary paper does not exist; there are: grid"]);
    for (option, message) in [
        ("--mu=0", "mu = 0 is not valid"),
        ("--lambda=-1", "lambda = -1 is not valid"),
        ("--g=0.3", "g = 0.3 is not valid: the dictionary has 0.4"),
        ("--top=0", "top = 0 is not valid"),
    ] {
        fails(dir, &["fit", "m.csv", "--dictionary", "grid", option], &[message]);
    }
}

#[test]
fn questions_without_a_farm_say_what_to_do_and_make_none() {
    let dir = folder();
    write(dir.path(), "m.csv", &(HEAD.to_owned() + &rows("R", 0.5)));
    for verb in [&["status"][..], &["list"], &["show", "paper"], &["export", "paper"], &["fit", "m.csv"]] {
        fails(dir.path(), verb, &["there is no farm in farm-data: run `farmctl submit` first"]);
    }
    fails(
        dir.path(),
        &["list", "--server", "http://127.0.0.1:9"],
        &["no coordinator answers at http://127.0.0.1:9"],
    );
    assert!(!dir.path().join("farm-data").exists());
}

#[test]
fn a_name_belongs_to_one_grid() {
    let farm = farm();
    write(farm.path(), "grid.toml", &GRID.replace("0.9,", "0.8,"));
    fails(
        farm.path(),
        &["submit", "grid.toml"],
        &["dictionary grid exists with another grid or physics version: choose another name"],
    );
    assert_eq!(run(farm.path(), &["submit", "grid.toml", "--name", "other", "-q"]).code, 0);
}

/// Runs as nobody if the tests run as root, whom no permission stops.
#[test]
fn a_data_directory_that_cannot_be_written_is_refused() {
    let dir = folder();
    let data = dir.path().join("data");
    std::fs::create_dir(&data).unwrap();
    std::fs::set_permissions(dir.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    std::fs::set_permissions(&data, std::fs::Permissions::from_mode(0o555)).unwrap();
    // The build folder may be closed to others: nobody gets a copy.
    let copy = dir.path().join("farmctl");
    std::fs::copy(program("farmctl"), &copy).unwrap();
    let mut command = Command::new(copy);
    command.args(["submit", "--data"]).arg(&data).current_dir(dir.path());
    if std::fs::write(data.join("probe"), "").is_ok() {
        std::fs::remove_file(data.join("probe")).unwrap();
        command.uid(65_534);
    }
    let ran: Ran = command.output().unwrap().into();
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    assert!(ran.stderr.contains("cannot be written to: Permission denied"), "{}", ran.stderr);
    assert_eq!(std::fs::read_dir(&data).unwrap().count(), 0);
    fails(
        dir.path(),
        &["submit", "--data", "/dev/null/farm"],
        &["data directory /dev/null/farm: cannot be created"],
    );
}

#[test]
fn a_database_that_is_none_is_refused_and_left_alone() {
    let dir = folder();
    let file = dir.path().join("farm-data/farm.db");
    std::fs::create_dir(dir.path().join("farm-data")).unwrap();
    std::fs::write(&file, "this is a letter, not a database; it is long enough to be looked at closely")
        .unwrap();
    fails(dir.path(), &["list"], &["farm.db", "file is not a database"]);
    assert!(std::fs::read_to_string(&file).unwrap().starts_with("this is a letter"));
}

#[test]
fn a_second_command_joins_the_farm_that_is_running() {
    let dir = folder();
    // Some seconds of work, so that the farm is there to be joined.
    write(dir.path(), "long.toml", &GRID.replace("walks = 5000", "walks = 2500000"));
    let submit = farmctl(dir.path()).args(["submit", "long.toml", "-q"]).spawn().unwrap();
    let mut submit = farm_tests::process::Killed(submit);
    let joined = (0..100).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(50));
        let ran = run(dir.path(), &["status", "--json"]);
        (ran.code == 0).then(|| json(&ran, "status")).filter(|s| s["jobs_leased"] != 0)
    });
    let status = joined.expect("the running farm answers");
    assert!(status["address"].as_str().unwrap().starts_with("http://127.0.0.1:"));
    assert_eq!(status["workers"].as_array().unwrap().len(), 1);
    submit.0.kill().unwrap();
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
fn an_interrupted_submission_says_so_and_goes_on_later() {
    let dir = folder();
    write(dir.path(), "long.toml", &GRID.replace("walks = 5000", "walks = 500000"));
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
fn help_and_completions_are_there() {
    let dir = folder();
    let help = run(dir.path(), &["--help"]);
    assert_eq!(help.code, 0);
    for verb in ["submit", "fit", "simulate", "status", "list", "show", "export", "completions"] {
        assert!(help.stdout.contains(verb), "{verb}");
        assert_eq!(run(dir.path(), &[verb, "--help"]).code, 0, "{verb}");
    }
    for shell in ["bash", "zsh", "fish"] {
        assert!(run(dir.path(), &["completions", shell]).stdout.contains("farmctl"), "{shell}");
    }
    assert_eq!(run(dir.path(), &["frobnicate"]).code, 2);
}
