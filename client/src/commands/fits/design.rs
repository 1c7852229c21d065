use anyhow::Result;
use farm_figures::design_figure;
use farm_lab::set_up::Assumed;
use farm_proto::wire::DesignRequest;
use optics_model::fit::{Design, DesignQuestion};
use serde::Serialize;

use super::chosen_dictionary;
use crate::answers::{SetUpJson, design_text};
use crate::cli::{DesignArgs, Global};
use crate::figure_files::{self, drawn};
use crate::output::{Output, wrapped};

pub(crate) async fn run(global: &Global, args: DesignArgs, output: &Output) -> Result<()> {
    let set_up = args.set_up.read(None)?;
    let question = args.question(&set_up)?;
    let assumed = set_up.assumed_of(args.channel.as_deref());
    let given = args.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.plot.as_deref().map_or(Ok(()), figure_files::check_path)?;
    let (dictionary, design) = chosen_dictionary::ask(global, given, async |connection, dictionary| {
        let request = DesignRequest { dictionary, ..(&question).into() };
        Ok(Design::try_from(connection.fits().design(request).await?.into_inner())?)
    })
    .await?;
    if let Some(path) = &args.plot {
        figure_files::write(&design_figure(&design)?, path)?;
    }
    let data = data(&dictionary, &question, &assumed, &design);
    output.print("design", &data, || {
        let assumed = assumed.text(question.settings().set_up.settings());
        let assumed = assumed.map_or_else(String::new, |text| format!("\n\n{}", wrapped(&text)));
        format!("{}{assumed}{}", design_text(&design, &question), drawn(&args.plot))
    })
}

/// What was asked, and what is answered.
#[derive(Debug, Serialize)]
pub(crate) struct DesignJson<'a> {
    dictionary: &'a str,
    noise: f64,
    noise_floor: f64,
    mu: f64,
    /// Null if nothing is known of μ.
    mu_std_error: Option<f64>,
    #[serde(flatten)]
    set_up: SetUpJson<'a>,
    /// The quantities of the set-up without a value.
    assumed: Vec<&'static str>,
    #[serde(flatten)]
    design: &'a Design,
}

pub(crate) fn data<'a>(
    dictionary: &'a str,
    question: &'a DesignQuestion,
    assumed: &Assumed,
    design: &'a Design,
) -> DesignJson<'a> {
    let (asked, known) = (question.settings(), question.settings().set_up.settings());
    DesignJson {
        dictionary,
        noise: asked.noise,
        noise_floor: asked.noise_floor,
        mu: known.mu,
        mu_std_error: (!asked.mu_free).then_some(known.mu_std_error),
        set_up: SetUpJson(known),
        assumed: assumed.names(),
        design,
    }
}
