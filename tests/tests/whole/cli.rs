//! `farmctl` from the user's side: output, JSON shapes, exit codes, and concurrent commands; its servers and autoscaler.

mod autoscale;
mod errors;
mod fit;
mod measurements;
mod prints;
mod scenes;
mod serve;
mod surroundings;
mod verbs;
mod web;

use std::process::Command;

use farm_tests::cli::{GRID, HEAD, fails, farm, first_progress, folder, json, keys, rows, run_line, write};
use farm_tests::process::{Ran, farmctl, program, run};

/// The JSON of the commands is of their kind. The shapes are in a snapshot of `farmctl`, apart from these.
#[test]
fn commands_print_json_of_their_kind() {
    let farm = farm();
    let dir = farm.path();
    let submit = json(&run_line(dir, "submit grid.toml --json"), "submit");
    assert_eq!((submit["state"].as_str(), submit["records_done"].as_u64()), (Some("done"), Some(8)));
    for (line, kind) in [
        ("list", "list"),
        ("status", "status"),
        ("show grid", "show"),
        ("simulate --sigma-t 6 --albedo 0.9 --g 0.4 --thickness 0.5 --walks 5000 --pixels 12", "simulate"),
        ("similar --sigma-t 6 --albedo 0.9 --g 0.4 --to 0,0.8", "similar"),
    ] {
        json(&run_line(dir, &format!("{line} --json")), kind);
    }
    let noisy = json(&run_line(dir, "show grid --noise --json"), "show");
    assert_eq!(keys(&noisy["noise"]), ["by_albedo", "median", "records", "worst"]);
    let worst = noisy["noise"]["worst"]["relative_std_error"].as_f64().unwrap();
    let median = noisy["noise"]["median"].as_f64().unwrap();
    assert!(0.0 < median && median <= worst && worst < 1.0, "{noisy}");
    let export = run_line(dir, "export grid --json --sigma-t 6 --albedo 0.9 --thickness 0.5");
    let expected = ["albedo", "channels", "g", "record", "sample_ior", "sigma_t_per_mm", "thickness_mm"];
    assert_eq!(keys(&json(&export, "record")), expected);
    let error = run_line(dir, "show none --json");
    assert_eq!(error.code, 1);
    assert!(json(&error, "error")["message"].as_str().unwrap().contains("dictionary none does not exist"));
}

/// Reflectances on the command line make one channel.
#[test]
fn reflectances_as_options_make_one_channel() {
    let dir = folder();
    let args = "simulate --sigma-t 6 --albedo 0.9 --g 0 --thickness 0.5 --scene smooth --walks 5000 --pixels 4 \
                --width 2 --rho-light 0.9 --rho-dark 0.1";
    let ran = run_line(dir.path(), args);
    let x: Vec<_> =
        ran.stdout.lines().skip(1).map(|l| l.split(',').take(2).collect::<Vec<_>>().join(" ")).collect();
    assert_eq!(x, ["mono -0.75", "mono -0.25", "mono 0.25", "mono 0.75"]);
}

#[test]
fn commands_that_only_ask_leave_no_events() {
    let farm = farm();
    for verb in ["list", "status", "events"] {
        assert_eq!(run(farm.path(), &[verb]).code, 0);
    }
    let events = run(farm.path(), &["events"]).stdout;
    assert_eq!(events.matches("COORDINATOR_STARTED").count(), 1, "{events}");
}

/// Commands in one folder do not interfere with each other.
#[test]
fn commands_in_one_folder_do_not_interfere() {
    let farm = farm();
    write(farm.path(), "m.csv", &(HEAD.to_owned() + &rows("R", 0.5)));
    let spawn = |args: &[&str]| {
        let mut command = farmctl(farm.path());
        command.args(args).stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        command.spawn().unwrap()
    };
    let fit = ["fit", "m.csv", "--dictionary", "grid", "--json"];
    let mut running: Vec<_> = (0..6).map(|_| spawn(&fit)).collect();
    // Two grids at a time, each with its own process, among read-only commands.
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

/// An interrupted submission reports that it was interrupted, and continues with the same command. Other commands do not
/// compute it before theirs, whether it was ended or killed.
#[test]
fn interrupted_submission_can_continue_later() {
    let dir = folder();
    write(dir.path(), "long.toml", GRID);
    for (number, signal) in ["-TERM", "-KILL"].into_iter().enumerate() {
        let mut submit = farmctl(dir.path())
            .args(["submit", "long.toml"])
            .env("FARM_PACE_MS", "60000")
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let pid = submit.id().to_string();
        // After the first line of progress it can be interrupted. The pipe's buffer holds the rest.
        let mut stderr = submit.stderr.take().unwrap();
        assert!(first_progress(&mut stderr).contains("of the work"));
        assert!(Command::new("kill").args([signal, &pid]).status().unwrap().success());
        let ended = submit.wait_with_output().unwrap();
        if signal == "-TERM" {
            let ran = Ran::from(ended);
            assert_eq!(ran.code, 130, "{}", ran.stdout);
            assert!(ran.stdout.contains("submit again to continue"), "{}", ran.stdout);
        }
        assert!(run(dir.path(), &["list"]).stdout.contains("long        interrupted"));
        write(dir.path(), "other.toml", &format!("{GRID}seed = {number}\n"));
        let name = format!("other-{number}");
        assert_eq!(run(dir.path(), &["submit", "other.toml", "--name", &name, "-q"]).code, 0);
        assert!(run(dir.path(), &["list"]).stdout.contains("long        interrupted"));
    }
    // Its state in the database is as it was: a server in this folder would continue it.
    assert!(!run(dir.path(), &["events", "-n", "1000"]).stdout.contains("CANCELLED"));
    let removed = || json(&run(dir.path(), &["data", "--remove-unfinished", "--yes", "--json"]), "data");
    assert_eq!(removed()["removed"], serde_json::json!(["long"]));
    assert_eq!(run(dir.path(), &["submit", "long.toml", "-q"]).code, 0);
    assert!(!run(dir.path(), &["list"]).stdout.contains("interrupted"));
    let data = removed();
    assert_eq!(data["removed"], serde_json::json!([]), "only what is not done is removed");
    let (rooms, all) = (data["dictionaries"].as_array().unwrap(), data["database_bytes"].as_f64().unwrap());
    assert_eq!(rooms.len(), 3);
    let sum: f64 = rooms.iter().map(|room| room["bytes"].as_f64().unwrap()).sum();
    assert!((0.5..1.0).contains(&(sum / all)), "{data}");
}

/// A reader that closes the pipe causes no error message.
#[test]
fn export_writes_whole_files() {
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
    let medium = "--sigma-t 6 --albedo 0.9 --g 0.4 --thickness 0.5";
    let simulate = format!("simulate {medium} --walks 5000");
    let profile = format!("profile {medium} --dictionary grid --channel R,G");
    for (command, file) in [
        ("fit m.csv --dictionary grid", "fit.svg"),
        ("fit m.csv --dictionary grid", "fit.png"),
        ("scale m.csv --dictionary grid", "scale.svg"),
        ("map m.csv --dictionary grid", "map.png"),
        ("measure m.csv --dictionary grid", "measure.svg"),
        ("show grid", "show.svg"),
        (&simulate, "simulated.pdf"),
        (&profile, "profile.svg"),
    ] {
        let ran = run_line(dir, &format!("{command} --plot {file}"));
        assert_eq!(ran.code, 0, "{command}: {}", ran.stderr);
        let bytes = std::fs::read(dir.join(file)).unwrap();
        let head: &[u8] = match file.rsplit_once('.').unwrap().1 {
            "svg" => b"<svg",
            "pdf" => b"%PDF-",
            _ => b"\x89PNG",
        };
        assert!(bytes.starts_with(head) && bytes.len() > 5_000, "{file}: {} bytes", bytes.len());
    }
    let sized = "fit m.csv --dictionary grid --plot narrow.png --plot-width 50.8 --plot-dpi 300";
    assert_eq!(run_line(dir, sized).code, 0);
    // The width of a PNG is in its header.
    assert_eq!(std::fs::read(dir.join("narrow.png")).unwrap()[16..20], 600_u32.to_be_bytes());
    assert_eq!(run_line(dir, &format!("{simulate} --plot-changes changes.svg")).code, 0);
    assert_eq!(run_line(dir, "measure m.csv --dictionary grid -o out").code, 0);
    for (file, text) in [
        ("table.csv", "material,channel,sigma_t_per_mm,"),
        ("media.py", "\"type\": \"homogeneous\""),
        ("media.xml", "<medium type=\"homogeneous\""),
        ("media.pbrt", "MakeNamedMedium"),
    ] {
        assert!(std::fs::read_to_string(dir.join("out").join(file)).unwrap().contains(text), "{file}");
    }
}

/// The help lists the verbs, and completions are made for each shell. That each verb has help is a unit test of `farmctl`.
#[test]
fn help_and_completions_are_there() {
    let dir = folder();
    let help = run(dir.path(), &["--help"]);
    assert!(help.code == 0 && help.stdout.contains("submit") && help.stdout.contains("completions"));
    for shell in ["bash", "zsh", "fish"] {
        assert!(run(dir.path(), &["completions", shell]).stdout.contains("farmctl"), "{shell}");
    }
    assert_eq!(run(dir.path(), &["frobnicate"]).code, 2);
}
