//! Examples for the help of every verb.

pub(super) const SUBMIT: &str = "\
Examples:
  farmctl submit                                  compute the paper's dictionary in ./farm-data
  farmctl submit lab                              one for measurements of your own
  farmctl submit grid.toml --name fine            compute a grid of your own
  farmctl submit grid.toml --server http://farm:7700 --wait";

pub(super) const CAPTURE: &str = "\
Examples:
  farmctl capture examples/session/session.toml -o white    profiles, set-up and a report
  farmctl measure white                                     media from them
  farmctl capture session.toml --measure                    both
  farmctl capture --check IMG_0815.dng                      is this photograph usable?
  farmctl capture --board board.pdf                         a board to print";

pub(super) const CHECK: &str = "\
Examples:
  farmctl check examples/white.csv
  farmctl check wax.csv --json";

pub(super) const FIT: &str = "\
Examples:
  farmctl fit examples/white.csv
  farmctl fit examples/white.csv --g 0.4 --top 3 --plot fit.svg
  farmctl fit wax.csv --dictionary fine --sigma-t 4..8
  farmctl fit wax.csv --session session.json --thickness-std-error-mm 0.002 --bound";

pub(super) const SCALE: &str = "\
Examples:
  farmctl scale materials.csv
  farmctl scale materials.csv --g 0.4 --plot scale.svg";

pub(super) const MEASURE: &str = "\
Examples:
  farmctl measure materials.csv                        with the dictionary `lab`, computed if it is lacking
  farmctl measure examples/white.csv --dictionary paper
  farmctl measure white                                what `farmctl capture` wrote there
  farmctl measure materials.csv -o media --plot media.svg
  farmctl measure chart.csv --mixtures chart.toml      strong absorbers by dilution
  farmctl measure materials.csv --objective paper      as the paper did";

pub(super) const MAP: &str = "\
Examples:
  farmctl map examples/white.csv --plot map.png
  farmctl map examples/white.csv --channel R --g 0.4";

pub(super) const DESIGN: &str = "\
Examples:
  farmctl design --sigma-t 6 --albedo 0.9991 --g 0.4
  farmctl design --sigma-t 6 --albedo 0.9991 --g 0.4 --slabs 0.5,1 --slabs 0.5,0.5,1,1 --plot sets.svg
  farmctl design --sigma-t 6 --albedo 0.9991 --g 0.4 --shots 1,4,16 --thickness-std-error-mm 0.002";

pub(super) const PROFILE: &str = "\
Examples:
  farmctl profile --sigma-t 6.2 --albedo 0.993 --g 0.35 --thickness 0.5
  farmctl profile --sigma-t 6.2 --albedo 0.993 --g 0.35 --thickness 0.7 --channel R,G,B --plot profile.svg";

pub(super) const SIMILAR: &str = "\
Examples:
  farmctl similar --sigma-t 6 --albedo 0.9991 --g 0.4
  farmctl similar --sigma-t 6 --albedo 0.9991 --g 0.4 --to 0,0.8";

pub(super) const SERVE: &str = "\
Examples:
  farmctl serve                    the farm of ./farm-data
  farmctl serve --data lab         that of another folder";

pub(super) const WEB: &str = "\
Examples:
  farmctl web                                  the farm of this folder
  farmctl web --access client.toml             a server's farm
  farmctl web session1 session2                with these captures
  farmctl web --listen 0.0.0.0:7780 --behind https://farm.example.org/resins/ --no-browser";

pub(super) const SIMULATE: &str = "\
Examples:
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 > profile.csv
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 --walks 1e6 --plot changes.svg
  farmctl simulate --sigma-t 4,6,8 --albedo 0.9,0.99 --g 0.4 --thickness 0.5,1 -o profiles.csv
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5,1 --measurement white -o white.csv";

pub(super) const STATUS: &str = "\
Examples:
  farmctl status
  farmctl status --server http://farm:7700 --json";

pub(super) const LIST: &str = "\
Examples:
  farmctl list
  farmctl list --data /scratch/farm-data";

pub(super) const WATCH: &str = "\
Example:
  farmctl watch paper                             Ctrl-C ends the view, not the work";

pub(super) const WAIT: &str = "\
Examples:
  farmctl wait paper fine
  farmctl wait paper --timeout 3600";

pub(super) const EXPLAIN: &str = "\
Example:
  farmctl explain paper";

pub(super) const PAUSE: &str = "\
Example:
  farmctl pause paper                             `farmctl resume paper` carries on";

pub(super) const RESUME: &str = "\
Example:
  farmctl resume paper";

pub(super) const CANCEL: &str = "\
Example:
  farmctl cancel fine --reason superseded         `farmctl resume fine` carries on";

pub(super) const RETRY: &str = "\
Example:
  farmctl retry paper                             `farmctl show paper` lists the failed jobs and their errors";

pub(super) const PRIORITY: &str = "\
Examples:
  farmctl priority fine 10                        before everything of priority 0
  farmctl priority fine -10                       when nothing else is left to do";

pub(super) const DELETE: &str = "\
Example:
  farmctl delete fine --yes";

pub(super) const WORKERS: &str = "\
Examples:
  farmctl workers
  farmctl workers drain node7:4711                let this one finish its jobs and leave";

pub(super) const DRAIN: &str = "\
Example:
  farmctl workers drain node7:4711";

pub(super) const READMIT: &str = "\
Examples:
  farmctl workers readmit node7:4711
  farmctl workers readmit worker@10.0.0.7";

pub(super) const EVENTS: &str = "\
Examples:
  farmctl events -n 20
  farmctl events --dictionary paper --follow";

pub(super) const DOCTOR: &str = "\
Examples:
  farmctl doctor
  farmctl doctor --repair                         also recompute damaged records";

pub(super) const BACKUP: &str = "\
Example:
  farmctl backup /backups/farm-2026-11-21.db";

pub(super) const RESTORE: &str = "\
Example:
  farmctl restore /backups/farm-2026-11-21.db --data restored-data";

pub(super) const HEALTH: &str = "\
Examples:
  farmctl health --server http://127.0.0.1:7700
  farmctl health --access client.toml --quiet";

pub(super) const ACCESS_CREATE: &str = "\
Examples:
  farmctl access create access --host farm.example.org
  farmctl access create access --host farm.example.org --host 10.0.0.5 --mutual";

pub const ACCESS_ADD: &str = "\
Examples:
  farmctl access add worker node7          writes access/node7.toml, for that machine
  farmctl access add client alice --folder /etc/farm";

pub const ACCESS_REVOKE: &str = "\
Examples:
  farmctl access revoke alice
  farmctl access revoke node7 --folder /etc/farm";

pub const ACCESS_LIST: &str = "\
Example:
  farmctl access list --folder /etc/farm";

pub(super) const SHOW: &str = "\
Examples:
  farmctl show paper
  farmctl show paper --plot overview.png";

pub(super) const EXPORT: &str = "\
Examples:
  farmctl export paper -o paper.csv
  farmctl export paper --sigma-t 6,9 --g 0.4 > part.csv
  farmctl export paper --npz paper.npz            arrays for NumPy
  farmctl export paper --json > paper.jsonl       one record per line";

pub(super) const COMPLETIONS: &str = "\
Example:
  farmctl completions bash > ~/.local/share/bash-completion/completions/farmctl";

pub(super) const MANUAL: &str = "\
Examples:
  farmctl manual ~/.local/share/man/man1    then: man farmctl-measure";

#[cfg(test)]
mod tests {
    use clap::{Command, CommandFactory as _, Parser as _};

    use crate::cli::Cli;

    /// The example commands of a verb.
    fn examples(command: &Command) -> Vec<String> {
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let lines = help.lines().filter(|line| line.starts_with("  farmctl "));
        // What it does stands behind two spaces.
        lines.map(|line| line.trim_start().split("  ").next().unwrap_or_default().to_owned()).collect()
    }

    fn check(command: &Command, name: &str, checked: &mut usize) {
        let verbs: Vec<_> = command.get_subcommands().filter(|c| c.get_name() != "help").collect();
        let examples = examples(command);
        for example in &examples {
            let words = example.split_whitespace().take_while(|word| *word != ">");
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
}
