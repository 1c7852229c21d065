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

use std::io::{BufRead as _, BufReader};
use std::process::Command;

use farm_tests::cli::{GRID, HEAD, fails, farm, folder, json, keys, rows, write};
use farm_tests::process::{Process, Ran, farmctl, program, run};

/// Verbs answer in JSON, each with its kind; the snapshot of `client/src/commands/tests` has their fields.
#[test]
fn verbs_answer_in_json() {
    let farm = farm();
    let dir = farm.path();
    let submit = json(&run(dir, &["submit", "grid.toml", "--json"]), "submit");
    assert_eq!((submit["state"].as_str(), submit["records_done"].as_u64()), (Some("done"), Some(8)));
    let list = json(&run(dir, &["list", "--json"]), "list");
    assert_eq!(keys(&list["dictionaries"][0]), keys(&submit));
    assert_eq!(json(&run(dir, &["status", "--json"]), "status")["dictionaries"][0]["name"], "grid");
    let noisy = json(&run(dir, &["show", "grid", "--noise", "--json"]), "show");
    assert_eq!(keys(&noisy["noise"]), ["by_albedo", "median", "records", "worst"]);
    let worst = noisy["noise"]["worst"]["relative_std_error"].as_f64().unwrap();
    let median = noisy["noise"]["median"].as_f64().unwrap();
    assert!(0.0 < median && median <= worst && worst < 1.0, "{noisy}");
    let one = ["export", "grid", "--json", "--sigma-t", "6", "--albedo", "0.9", "--thickness", "0.5"];
    let export = json(&run(dir, &one), "record");
    let expected = ["albedo", "channels", "g", "record", "sample_ior", "sigma_t_per_mm", "thickness_mm"];
    assert_eq!(keys(&export), expected);
    let error = run(dir, &["show", "none", "--json"]);
    assert_eq!(error.code, 1);
    assert!(json(&error, "error")["message"].as_str().unwrap().contains("dictionary none does not exist"));
}

/// The profile is the same for any number of threads.
#[test]
fn simulate_equals_the_profile_of_the_dictionary() {
    let farm = farm();
    let dir = farm.path();
    let simulate = |threads: &str| {
        let args = "simulate --sigma-t 6 --albedo 0.999 --g 0.4 --thickness 1 --scene paper --walks 5000 \
                    --threads";
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

/// Reflectances on the command line make one channel.
#[test]
fn reflectances_as_options_make_one_channel() {
    let dir = folder();
    let args = "simulate --sigma-t 6 --albedo 0.9 --g 0 --thickness 0.5 --scene smooth --walks 5000 --pixels 4 \
                --width 2 --rho-light 0.9 --rho-dark 0.1";
    let ran = run(dir.path(), &args.split_whitespace().collect::<Vec<_>>());
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

/// A second command joins the farm that is running.
#[test]
fn second_command_joins_the_running_farm() {
    let dir = folder();
    write(dir.path(), "long.toml", GRID);
    let mut submit = farmctl(dir.path());
    // The farm still runs when the second command looks.
    submit.args(["submit", "long.toml", "-q"]).env("FARM_PACE_MS", "60000");
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

/// An interrupted submission reports that it was interrupted, and continues with the next command.
#[test]
fn interrupted_submission_can_continue_later() {
    let dir = folder();
    write(dir.path(), "long.toml", GRID);
    let mut submit = farmctl(dir.path())
        .args(["submit", "long.toml"])
        .env("FARM_PACE_MS", "60000")
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let pid = submit.id().to_string();
    // After the first line of progress it can be interrupted. The pipe's buffer holds the rest.
    let mut progress = BufReader::new(submit.stderr.take().unwrap());
    let mut line = String::new();
    progress.read_line(&mut line).unwrap();
    assert!(line.contains("of the work"), "{line}");
    assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
    let ran: Ran = submit.wait_with_output().unwrap().into();
    assert_eq!(ran.code, 130, "{}", ran.stdout);
    assert!(ran.stdout.contains("submit again to continue"), "{}", ran.stdout);
    assert_eq!(run(dir.path(), &["submit", "long.toml", "-q"]).code, 0);
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
    let command = ["m.csv", "--dictionary", "grid"];
    let medium = ["--sigma-t", "6", "--albedo", "0.9", "--g", "0.4", "--thickness", "0.5", "--walks", "5000"];
    let within = [&medium[..8], &["--dictionary", "grid", "--channel", "R,G"]].concat();
    for (verb, arguments, file) in [
        ("fit", &command[..], "fit.svg"),
        ("fit", &command[..], "fit.png"),
        ("scale", &command[..], "scale.svg"),
        ("map", &command[..], "map.png"),
        ("measure", &command[..], "measure.svg"),
        ("show", &["grid"][..], "show.svg"),
        ("simulate", &medium[..], "simulated.pdf"),
        ("profile", &within[..], "profile.svg"),
    ] {
        let ran = run(dir, &[&[verb][..], arguments, &["--plot", file]].concat());
        assert_eq!(ran.code, 0, "{verb}: {}", ran.stderr);
        let bytes = std::fs::read(dir.join(file)).unwrap();
        let head: &[u8] = match file.rsplit_once('.').unwrap().1 {
            "svg" => b"<svg",
            "pdf" => b"%PDF-",
            _ => b"\x89PNG",
        };
        assert!(bytes.starts_with(head) && bytes.len() > 5_000, "{file}: {} bytes", bytes.len());
    }
    let sized = ["--plot", "narrow.png", "--plot-width", "50.8", "--plot-dpi", "300"];
    assert_eq!(run(dir, &[&["fit"][..], &command, &sized].concat()).code, 0);
    // The width of a PNG is in its header.
    assert_eq!(std::fs::read(dir.join("narrow.png")).unwrap()[16..20], 600_u32.to_be_bytes());
    assert_eq!(run(dir, &[&["simulate"][..], &medium, &["--plot-changes", "changes.svg"]].concat()).code, 0);
    assert_eq!(run(dir, &[&["measure"][..], &command, &["-o", "out"]].concat()).code, 0);
    for (file, text) in [
        ("table.csv", "material,channel,sigma_t_per_mm,"),
        ("media.py", "\"type\": \"homogeneous\""),
        ("media.xml", "<medium type=\"homogeneous\""),
        ("media.pbrt", "MakeNamedMedium"),
    ] {
        assert!(std::fs::read_to_string(dir.join("out").join(file)).unwrap().contains(text), "{file}");
    }
}

/// The examples in the help of every verb are checked in `client/src/commands/tests/examples.rs`.
#[test]
fn help_and_completions_are_there() {
    let dir = folder();
    for args in [&["--help"][..], &["fit", "--help"]] {
        let help = run(dir.path(), args);
        assert!(help.code == 0 && help.stdout.contains("Usage: farmctl"), "{}", help.stdout);
    }
    for shell in ["bash", "zsh", "fish"] {
        assert!(run(dir.path(), &["completions", shell]).stdout.contains("farmctl"), "{shell}");
    }
    assert_eq!(run(dir.path(), &["frobnicate"]).code, 2);
}
