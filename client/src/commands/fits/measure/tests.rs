use clap::FromArgMatches as _;

use super::*;

/// The arguments of the verb, parsed from its words.
fn parsed(words: &[&str]) -> MeasureArgs {
    let command = MeasureArgs::augment_args(clap::Command::new("measure")).no_binary_name(true);
    MeasureArgs::from_arg_matches(&command.get_matches_from(words)).unwrap()
}

/// `capture --measure` measures as `farmctl measure DIR` does.
#[test]
fn folder_has_the_command_line_defaults() {
    let folder = tempfile::tempdir().unwrap();
    let session = r#"{"format": "farmctl-session/1", "mu_std_error": 0.01, "gain_std_error": 0.004}"#;
    for (name, text) in [("measurements.csv", ""), ("session.json", session), ("grid.toml", "g = [0.5]\n")] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let path = folder.path().to_str().unwrap();
    let [parsed, direct] =
        [Inputs::of(parsed(&[path])), Inputs::of(MeasureArgs::new(folder.path().to_owned()))]
            .map(Result::unwrap);
    assert_eq!(format!("{parsed:?}"), format!("{direct:?}"));
    assert_eq!(direct.options.settings().mu_std_error, 0.01);
}

/// The paper's objective is refused where media or intervals are required.
#[test]
fn paper_objective_gives_no_media() {
    let inputs = |more: &[&str]| {
        let args = parsed(&[&["a.csv", "--objective", "paper"][..], more].concat());
        Inputs::of(args).map(|_| ()).map_err(|e| e.to_string())
    };
    assert_eq!(inputs(&[]), Ok(()));
    for (more, named) in [(&["-o", "media"][..], "--output"), (&["--bound"], "--bound")] {
        let error = inputs(more).unwrap_err();
        assert!(error.contains("--objective paper") && error.ends_with(named), "{error}");
    }
}

/// A kept command line has the question, and neither the way to the farm nor that in.
#[test]
fn kept_commands_have_the_question_alone() {
    let line = "measure a.csv --server http://key@farm:7700 --mu 1.2 --access=/home/me/farm.access --data /tmp/x -q --keep";
    let found = kept_command(line.split(' ').map(str::to_owned));
    assert_eq!(found, "farmctl measure a.csv --mu 1.2 --keep");
}
