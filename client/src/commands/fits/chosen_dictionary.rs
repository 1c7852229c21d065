//! The dictionary that a question goes to.

use anyhow::{Result, bail};
use farm_proto::DictionaryName;
use farm_proto::status::{DictionaryState, DictionaryStatus};
use optics_model::Grid;

use crate::cli::Global;
use crate::commands::dictionaries::list;
use crate::connection::{Connection, Purpose, lacks_farm, with_farm};

/// What `submit` computes without a grid file.
const USUAL: &str = "paper";

/// Checks a name that was given, before anything is connected.
pub(crate) fn check(given: Option<&String>) -> optics_model::Result<()> {
    given.map_or(Ok(()), |name| {
        DictionaryName::new(name.as_str()).map(|_| ()).map_err(|e| e.within("dictionary"))
    })
}

/// Asks a dictionary of a farm that exists: the one that was named; without a name the usual one, or the only one. Returns
/// its name with the answer.
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
    let names: Vec<String> = list::fetch(connection).await?.into_iter().map(|d| d.name.to_string()).collect();
    pick(&names)
}

/// A dictionary that is to be computed.
#[derive(Debug)]
pub(crate) struct WantedDictionary {
    pub name: DictionaryName,
    pub grid: Grid,
    pub records_done: usize,
}

impl WantedDictionary {
    pub fn new(name: DictionaryName, grid: Grid) -> Self {
        Self { name, grid, records_done: 0 }
    }
}

/// The dictionary of a command that computes one on this machine where there is none.
pub(crate) enum Chosen {
    Complete(String),
    Lacking(WantedDictionary),
}

/// The paper's, for a command that computes on this machine, if its folder holds no farm yet.
pub(crate) fn of_an_empty_folder(global: &Global) -> Result<Option<WantedDictionary>> {
    Ok(if lacks_farm(global) { Some(usual()?) } else { None })
}

/// The dictionary that was named; without a name the usual one, or the only one, which on this machine need not be complete.
pub(crate) async fn or_lacking(connection: &Connection, given: Option<&String>) -> Result<Chosen> {
    if given.is_some() || connection.is_server() {
        return Ok(Chosen::Complete(name(connection, given).await?));
    }
    let dictionaries = list::fetch(connection).await?;
    if dictionaries.is_empty() {
        return Ok(Chosen::Lacking(usual()?));
    }
    let name = pick(&dictionaries.iter().map(|d| d.name.to_string()).collect::<Vec<_>>())?;
    let is_running = |d: &DictionaryStatus| d.state() == DictionaryState::Running;
    let running = dictionaries.into_iter().find(|d| d.name.as_str() == name && is_running(d));
    Ok(running.map_or(Chosen::Complete(name), |d| {
        let records_done = d.records_done();
        Chosen::Lacking(WantedDictionary { name: d.name, grid: d.grid, records_done })
    }))
}

fn usual() -> Result<WantedDictionary> {
    Ok(WantedDictionary::new(DictionaryName::new(USUAL)?, Grid::paper()))
}

fn pick(names: &[String]) -> Result<String> {
    match names {
        [] => bail!(
            "there is no dictionary yet: `farmctl submit` computes the paper's, in half a minute on two cores"
        ),
        [only] => Ok(only.clone()),
        several if several.iter().any(|n| n == USUAL) => Ok(USUAL.to_owned()),
        several => {
            bail!("there are several dictionaries: name one with --dictionary, of {}", several.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_dictionary_needs_no_name() {
        let names = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        assert_eq!(pick(&names(&["fine"])).unwrap(), "fine");
        assert_eq!(pick(&names(&["fine", "paper"])).unwrap(), "paper");
        let message = pick(&names(&["a", "b"])).unwrap_err().to_string();
        assert!(message.ends_with("name one with --dictionary, of a, b"), "{message}");
        assert!(pick(&[]).unwrap_err().to_string().contains("`farmctl submit` computes the paper's"));
    }
}
