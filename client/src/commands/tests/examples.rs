//! Checks that the examples in the help of every verb are accepted.

use clap::{Command, CommandFactory as _, Parser as _};

use crate::commands::Cli;

/// The example commands of a verb.
fn examples(command: &Command) -> Vec<String> {
    let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let lines = help.lines().filter(|line| line.starts_with("  farmctl "));
    // The explanation of an example follows after two spaces.
    lines.map(|line| line.trim_start().split("  ").next().unwrap_or_default().to_owned()).collect()
}

/// The words of a command line, as a shell reads those with single quotes.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut is_quoted) = (vec![String::new()], false);
    for c in line.chars() {
        match c {
            '\'' => is_quoted = !is_quoted,
            ' ' if !is_quoted => words.push(String::new()),
            _ => words.last_mut().unwrap().push(c),
        }
    }
    words
}

fn check(command: &Command, name: &str, checked: &mut usize) {
    let verbs: Vec<_> = command.get_subcommands().filter(|c| c.get_name() != "help").collect();
    let examples = examples(command);
    for example in &examples {
        let words = words(example).into_iter().take_while(|word| word != ">");
        let parsed = Cli::try_parse_from(words);
        assert!(parsed.is_ok(), "{example}: {}", parsed.err().map(|e| e.to_string()).unwrap_or_default());
    }
    if verbs.is_empty() && name != "farmctl workers list" {
        assert!(
            examples.iter().any(|e| e.starts_with(name)),
            "{name} has no example of itself: {examples:?}"
        );
        *checked += 1;
    }
    for verb in verbs {
        check(verb, &format!("{name} {}", verb.get_name()), checked);
    }
}

#[test]
fn every_verb_has_examples_that_are_accepted() {
    let mut checked = 0;
    check(&Cli::command(), "farmctl", &mut checked);
    assert!(checked >= 30, "{checked} verbs");
}
