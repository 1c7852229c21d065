//! The dictionary that a question goes to.

use anyhow::{Result, bail};
use farm_proto::DictionaryName;

use super::list;
use crate::connection::Connection;

/// What `submit` computes without a grid file.
const USUAL: &str = "paper";

/// Checks a name that was given, before anything is connected.
pub(crate) fn check(given: Option<&String>) -> optics_model::Result<()> {
    given.map_or(Ok(()), |name| {
        DictionaryName::new(name.as_str()).map(|_| ()).map_err(|e| e.within("dictionary"))
    })
}

/// The dictionary that was named; without a name the usual one, or the only one.
pub(crate) async fn name(connection: &Connection, given: Option<&String>) -> Result<String> {
    if let Some(name) = given {
        return Ok(name.clone());
    }
    let names: Vec<String> = list::fetch(connection).await?.into_iter().map(|d| d.name.to_string()).collect();
    pick(&names)
}

fn pick(names: &[String]) -> Result<String> {
    match names {
        [] => bail!(
            "there is no dictionary yet: `farmctl submit` computes the paper's, which takes a minute on two cores"
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
    fn the_only_dictionary_needs_no_name() {
        let names = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        assert_eq!(pick(&names(&["fine"])).unwrap(), "fine");
        assert_eq!(pick(&names(&["fine", "paper"])).unwrap(), "paper");
        let told = pick(&names(&["a", "b"])).unwrap_err().to_string();
        assert!(told.ends_with("name one with --dictionary, of a, b"), "{told}");
        assert!(pick(&[]).unwrap_err().to_string().contains("`farmctl submit` computes the paper's"));
    }
}
