//! Selects the dictionary of a question.

use anyhow::{Context as _, Result, bail};
use farm_lab::grid_file::named_grid;
use farm_lab::slab_grid::slab_grid;
use farm_proto::DictionaryName;
use farm_proto::status::{DictionaryState, DictionaryStatus};
use optics_fit::predicts_thickness;
use optics_model::{Digest, Grid};

use crate::cli::Global;
use crate::commands::dictionaries::list;
use crate::connection::{Connection, Purpose, lacks_farm, with_farm};

/// The dictionary of a laboratory's own measurements, which `measure` computes if there is none.
const USUAL: &str = "lab";
/// Names of the same for slabs of other thicknesses begin so.
const FOR_SLABS: &str = "lab-";
/// Thicknesses of slabs for which it is computed unasked.
const PLAUSIBLE_MM: std::ops::RangeInclusive<f64> = 0.05..=10.0;
/// The dictionary that is used only where it is named: its rough surfaces lose light, which real ones do not.
const NAMED_ONLY: &str = "paper";

/// Checks a given name before any connection.
pub(crate) fn check(given: Option<&String>) -> optics_model::Result<()> {
    given.map_or(Ok(()), |name| {
        DictionaryName::new(name.as_str()).map(|_| ()).map_err(|e| e.within("dictionary"))
    })
}

/// Queries a dictionary of an existing farm: the named one; without a name the default. Returns its
/// name with the answer.
pub(crate) async fn ask<T>(
    global: &Global,
    given: Option<&String>,
    question: impl AsyncFn(&Connection, String) -> Result<T>,
) -> Result<(String, T)> {
    with_farm(global, Purpose::Ask, async |connection| {
        let dictionary = name(connection, given).await?;
        let answer = question(connection, dictionary.clone()).await?;
        Ok((dictionary, answer))
    })
    .await
}

async fn name(connection: &Connection, given: Option<&String>) -> Result<String> {
    if let Some(name) = given {
        return Ok(name.clone());
    }
    pick(&names(&list::fetch(connection).await?))
}

/// Names of the dictionaries that a question about a measurement file may be asked: those for all boards need the board
/// of a session.
fn names(dictionaries: &[DictionaryStatus]) -> Vec<String> {
    let with_boards = dictionaries.iter().filter(|d| !d.grid.scene().is_for_all_boards());
    with_boards.map(|d| d.name.to_string()).collect()
}

/// A dictionary to compute.
#[derive(Debug)]
pub(crate) struct WantedDictionary {
    pub name: DictionaryName,
    pub grid: Grid,
}

impl WantedDictionary {
    pub fn new(name: DictionaryName, grid: Grid) -> Self {
        Self { name, grid }
    }
}

/// The dictionary of a command that computes a missing one on this machine.
pub(crate) enum Chosen {
    Complete(String),
    Lacking(WantedDictionary),
}

/// The built-in dictionary with the given name, or the default for slabs, for a command that computes on this machine, if
/// its folder holds no farm yet.
pub(crate) fn of_an_empty_folder(
    global: &Global,
    given: Option<&String>,
    slabs_mm: &[f64],
) -> Result<Option<WantedDictionary>> {
    match given {
        _ if !lacks_farm(global) => Ok(None),
        Some(name) => Ok(built_in(name)),
        None => for_slabs(slabs_mm).map(Some),
    }
}

/// The named dictionary; without a name the default for slabs. On this machine it may be incomplete, and a built-in one
/// may be missing.
pub(crate) async fn or_lacking(
    connection: &Connection,
    given: Option<&String>,
    slabs_mm: &[f64],
) -> Result<Chosen> {
    if connection.is_server() {
        return Ok(Chosen::Complete(name(connection, given).await?));
    }
    let dictionaries = list::fetch(connection).await?;
    let usable = names(&dictionaries);
    let (name, wanted) = match given {
        Some(name) => (name.clone(), built_in(name)),
        None => default_for(&usable, slabs_mm, |name| {
            let stored = dictionaries.iter().find(|d| d.name.as_str() == name);
            stored.is_some_and(|d| is_asked(&d.grid, slabs_mm))
        })?,
    };
    if !dictionaries.iter().any(|d| d.name.as_str() == name) {
        return Ok(wanted.map_or(Chosen::Complete(name), Chosen::Lacking));
    }
    let is_running = |d: &DictionaryStatus| d.state() == DictionaryState::Running || d.is_interrupted();
    let running = dictionaries.into_iter().find(|d| d.name.as_str() == name && is_running(d));
    Ok(match running {
        Some(d) if given.is_none() || built_in(&name).is_some() => {
            Chosen::Lacking(WantedDictionary::new(d.name, d.grid))
        }
        _ => Chosen::Complete(name),
    })
}

/// The default of a farm, if it is asked about these slabs; else the one to compute for them.
fn default_for(
    names: &[String],
    slabs_mm: &[f64],
    is_asked: impl Fn(&str) -> bool,
) -> Result<(String, Option<WantedDictionary>)> {
    let can_choose = names.iter().any(|name| name != NAMED_ONLY && !name.starts_with(FOR_SLABS));
    match pick(names) {
        Ok(name) if is_asked(&name) => Ok((name, None)),
        Err(error) if can_choose => Err(error),
        _ => for_slabs(slabs_mm).map(|wanted| (wanted.name.to_string(), Some(wanted))),
    }
}

/// The default for slabs: `lab`, or the same for their thicknesses where it does not predict them.
fn for_slabs(slabs_mm: &[f64]) -> Result<WantedDictionary> {
    if predicts(&Grid::lab(), slabs_mm) {
        return built_in(USUAL).context("lab is built in");
    }
    if let Some(other) = slabs_mm.iter().find(|mm| !PLAUSIBLE_MM.contains(*mm)) {
        bail!(
            "thickness_mm = {other}: `measure` computes a dictionary for slabs of {} to {} mm; is it in another unit? \
             `farmctl submit GRID.toml` computes one for any thickness",
            PLAUSIBLE_MM.start(),
            PLAUSIBLE_MM.end()
        );
    }
    let grid = slab_grid(slabs_mm.to_vec()).context("a dictionary for these slabs")?;
    let digest = Digest::of_plan(&grid).to_string();
    Ok(WantedDictionary::new(DictionaryName::new(format!("{FOR_SLABS}{}", &digest[..12]))?, grid))
}

/// Whether a dictionary is asked about slabs: it predicts them, or has a scene of its own, in whose place that of `lab`
/// would be another set-up without a word.
fn is_asked(grid: &Grid, slabs_mm: &[f64]) -> bool {
    grid.scene() != Grid::lab().scene() || predicts(grid, slabs_mm)
}

fn predicts(grid: &Grid, slabs_mm: &[f64]) -> bool {
    slabs_mm.iter().all(|mm| predicts_thickness(grid, *mm))
}

fn built_in(name: &str) -> Option<WantedDictionary> {
    Some(WantedDictionary::new(DictionaryName::new(name).ok()?, named_grid(name)?))
}

/// The default among the dictionaries of a farm: `lab`, else the only one besides the paper's.
fn pick(names: &[String]) -> Result<String> {
    if names.iter().any(|name| name == USUAL) {
        return Ok(USUAL.to_owned());
    }
    let mut others: Vec<&String> = names.iter().filter(|name| *name != NAMED_ONLY).collect();
    // One that was asked for goes before those that measurements needed.
    if others.iter().any(|name| !name.starts_with(FOR_SLABS)) {
        others.retain(|name| !name.starts_with(FOR_SLABS));
    }
    match others[..] {
        [only] => Ok(only.clone()),
        [] if names.is_empty() => bail!(
            "there is no dictionary yet: `farmctl submit lab` computes one for a laboratory's own measurements, `farmctl \
             submit` the paper's"
        ),
        [] => bail!(
            "there is only the paper's dictionary, whose rough surfaces lose light: `farmctl submit lab` computes one for \
             a laboratory's own measurements, `--dictionary {NAMED_ONLY}` asks the paper's"
        ),
        _ => bail!("there are several dictionaries: name one with --dictionary, of {}", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use clap::{Arg, Command, CommandFactory as _};

    use super::*;
    use crate::commands::Cli;

    /// The verbs with an argument `--dictionary`, each with the argument's help.
    fn helps(command: &Command) -> Vec<(String, String)> {
        let own = command.get_arguments().filter(|arg| arg.get_id() == "dictionary");
        let help = |arg: &Arg| arg.get_help().map(ToString::to_string).unwrap_or_default();
        let own = own.map(|arg| (command.get_name().to_owned(), help(arg)));
        own.chain(command.get_subcommands().flat_map(helps)).collect()
    }

    /// All verbs with `--dictionary` have the default but `events`, where it is a filter.
    #[test]
    fn help_states_the_usual_dictionaries() {
        let stated = format!("[default: {USUAL}, else the only one but {NAMED_ONLY}]");
        let (with, without): (Vec<_>, Vec<_>) =
            helps(&Cli::command()).into_iter().partition(|(_, help)| help.contains(&stated));
        let names = |verbs: Vec<(String, String)>| {
            let mut names: Vec<String> = verbs.into_iter().map(|(verb, _)| verb).collect();
            names.sort();
            names
        };
        assert_eq!(names(with), ["design", "fit", "map", "measure", "profile", "scale"]);
        assert_eq!(names(without), ["events"]);
    }

    /// The paper's dictionary is never a default.
    #[test]
    fn default_is_lab_or_the_only_other() {
        let names = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        assert_eq!(pick(&names(&["fine"])).unwrap(), "fine");
        assert_eq!(pick(&names(&["fine", "paper"])).unwrap(), "fine");
        let message = pick(&names(&["paper"])).unwrap_err().to_string();
        assert!(
            message.contains("`farmctl submit lab`") && message.contains("--dictionary paper"),
            "{message}"
        );
        let message = pick(&names(&["a", "b"])).unwrap_err().to_string();
        assert!(message.ends_with("name one with --dictionary, of a, b"), "{message}");
        assert_eq!(pick(&names(&["fine", "paper", "lab"])).unwrap(), "lab");
        assert_eq!(pick(&names(&["fine", "lab-0123", "lab-4567"])).unwrap(), "fine");
        assert!(pick(&[]).unwrap_err().to_string().contains("`farmctl submit lab` computes one"));
    }

    /// Slabs that the default does not predict have a dictionary of their own, whose name follows from them.
    #[test]
    fn other_slabs_have_their_own_dictionary() {
        let chosen = |names: &[&str], slabs_mm: &[f64], is_asked: bool| {
            let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
            default_for(&names, slabs_mm, |_| is_asked)
        };
        let name =
            |names: &[&str], slabs_mm: &[f64], is_asked: bool| chosen(names, slabs_mm, is_asked).unwrap().0;
        assert_eq!(name(&["fine", "paper"], &[0.3], true), "fine");
        assert_eq!(name(&["paper"], &[0.5, 1.01], false), "lab");
        let thin = name(&["lab"], &[0.3, 0.602], false);
        assert!(thin.starts_with("lab-"), "{thin}");
        assert_eq!(thin, name(&["lab-1", "lab-2"], &[0.6, 0.3], false));
        assert!(chosen(&["lab"], &[0.3, 0.602], false).unwrap().1.unwrap().grid.thickness_mm() == [0.3, 0.6]);
        assert!(chosen(&["a", "b"], &[0.3], false).is_err());
        // A set-up of one's own is not replaced by that of `lab`.
        assert!(is_asked(&Grid::paper(), &[0.3]) && !is_asked(&Grid::lab(), &[0.3]));
        assert!(is_asked(&Grid::lab(), &[0.5, 1.01]));
        let refused = chosen(&[], &[0.3, 400.0], false).unwrap_err().to_string();
        assert!(refused.starts_with("thickness_mm = 400: ") && refused.contains("unit?"), "{refused}");
    }
}
