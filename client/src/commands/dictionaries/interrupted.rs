//! Dictionaries that earlier commands have left unfinished in a folder of this machine: they do not precede the jobs of
//! other commands.

use anyhow::Result;
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::{CancelRequest, ResumeRequest};

use super::list;
use crate::connection::Connection;
use crate::output::{INTERRUPTED, is_interrupted};

/// Marks all unfinished dictionaries of a farm that this command has just started as interrupted: no other process
/// computes in its folder.
pub(crate) async fn set_aside(connection: &Connection) -> Result<()> {
    if !connection.is_embedded() {
        return Ok(());
    }
    let dictionaries = list::fetch(connection).await?;
    for status in dictionaries.into_iter().filter(|d| d.state() == DictionaryState::Running) {
        interrupt(connection, &status).await?;
    }
    Ok(())
}

/// Marks a dictionary as interrupted.
pub(super) async fn interrupt(connection: &Connection, status: &DictionaryStatus) -> Result<()> {
    let request = CancelRequest { name: status.name.to_string(), reason: INTERRUPTED.to_owned() };
    connection.dictionaries().cancel(request).await?;
    Ok(())
}

/// Continues a dictionary if it was interrupted.
pub(super) async fn continued(connection: &Connection, status: DictionaryStatus) -> Result<DictionaryStatus> {
    if !is_interrupted(&status) {
        return Ok(status);
    }
    let request = ResumeRequest { name: status.name.to_string() };
    Ok(connection.dictionaries().resume(request).await?.into_inner().try_into()?)
}
