//! Implements `farmctl events`: prints what has happened on the farm, with `--follow` also what happens next.

use std::time::Duration;

use anyhow::Result;
use clap::Args;
use farm_link::logs::to_stderr;
use farm_proto::wire::{Event, ListEventsRequest};
use serde::Serialize;

use crate::cli::Global;
use crate::connection::outage::Outage;
use crate::connection::{Connection, Purpose, with_farm};
use crate::output::{Output, envelope, print_line, utc};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl events -n 20
  farmctl events --dictionary paper --follow")]
pub(crate) struct EventsArgs {
    /// Show only the events of this dictionary.
    #[arg(long, value_name = "NAME")]
    dictionary: Option<String>,
    /// Number of events to show, counted from the newest.
    #[arg(long, short = 'n', value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
    number: u32,
    /// Keep running, and show events as they happen.
    #[arg(long, short)]
    follow: bool,
}

/// Pause before the next poll for new events.
const LOOK: Duration = Duration::from_secs(1);

#[derive(Debug, Serialize)]
struct EventsJson {
    events: Vec<EventJson>,
}

#[derive(Debug, Serialize)]
struct EventJson {
    id: u64,
    unix_ms: u64,
    kind: String,
    dictionary: Option<String>,
    job: Option<u32>,
    worker: Option<String>,
    message: String,
    actor: Option<String>,
}

impl From<Event> for EventJson {
    fn from(event: Event) -> Self {
        let known = |text: String| (!text.is_empty()).then_some(text);
        Self {
            id: event.id,
            unix_ms: event.unix_ms,
            kind: event.kind,
            dictionary: known(event.dictionary),
            job: event.job,
            worker: known(event.worker),
            message: event.message,
            actor: known(event.actor),
        }
    }
}

pub(crate) async fn run(global: &Global, args: EventsArgs, output: &Output) -> Result<()> {
    with_farm(global, Purpose::Ask, async |connection| {
        let request = ListEventsRequest {
            page_size: args.number,
            page_token: String::new(),
            dictionary: args.dictionary.clone().unwrap_or_default(),
            newest: true,
        };
        let page = connection.farm().list_events(request.clone()).await?.into_inner();
        let events: Vec<EventJson> = page.events.into_iter().map(Into::into).collect();
        if args.follow {
            events.iter().try_for_each(|event| show(event, output))?;
            return follow(connection, request, page.next_page_token, output).await;
        }
        let data = EventsJson { events };
        output.print("events", &data, || data.events.iter().map(line).collect::<Vec<_>>().join("\n"))
    })
    .await
}

async fn follow(
    connection: &Connection,
    mut request: ListEventsRequest,
    mut page_token: String,
    output: &Output,
) -> Result<()> {
    request.newest = false;
    let mut outage = Outage::new(connection);
    loop {
        request.page_token.clone_from(&page_token);
        let page = match connection.farm().list_events(request.clone()).await {
            Ok(page) => page.into_inner(),
            Err(error) => {
                outage.outlast(error.into(), to_stderr).await?;
                continue;
            }
        };
        outage.is_over(to_stderr);
        if page.events.is_empty() {
            tokio::time::sleep(LOOK).await;
        }
        for event in page.events {
            show(&event.into(), output)?;
        }
        page_token = page.next_page_token;
    }
}

/// One event per line, also as JSON.
fn show(event: &EventJson, output: &Output) -> Result<()> {
    print_line(&if output.is_json() { envelope("event", event)? } else { line(event) })
}

fn line(event: &EventJson) -> String {
    let mut about = String::new();
    if let Some(dictionary) = &event.dictionary {
        about += &format!(" {dictionary}");
    }
    if let Some(job) = event.job {
        about += &format!(" job {job}");
    }
    if let Some(worker) = &event.worker {
        about += &format!(" worker {worker}");
    }
    let message = if event.message.is_empty() { String::new() } else { format!(": {}", event.message) };
    let actor = event.actor.as_ref().map_or_else(String::new, |actor| format!(" (by {actor})"));
    format!("{}  {:<18}{about}{message}{actor}", utc(event.unix_ms), event.kind)
}
