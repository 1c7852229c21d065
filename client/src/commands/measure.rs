use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use farm_lab::measurement_file::{MeasurementFile, Note};
use farm_lab::mixture_file::read_mixtures;
use farm_link::logs::tell;
use farm_proto::wire::{MeasureRequest, MeasureResponse};
use optics_model::fit::{Common, FitOptions, FitSettings, MaterialFit, Mixtures, ScaleCurve, Unmixed};
use serde::Serialize;

use super::chosen_dictionary::{self, Chosen, Wanted};
use super::session_folder::SessionFolder;
use super::submit;
use crate::answers::{Report, UsedOptions, budget_text, common_text, fits_text, inks_text, table_csv};
use crate::cli::{Global, MeasureArgs};
use crate::connection::{Purpose, with_farm};
use crate::figure_files;
use crate::interrupt::{Interrupted, interrupted};
use crate::output::{Output, grouped, write_whole};
use crate::renderers;

pub(crate) async fn run(global: &Global, mut args: MeasureArgs, output: &Output) -> Result<()> {
    let folder = SessionFolder::open(&mut args)?;
    let set_up = args.options.set_up.read()?;
    if let (Some(_), None, Some(error)) = (&folder, args.mu, set_up.mu_std_error()) {
        // The session's white reference says what the scale factor is, and how well it is known.
        (args.mu, args.mu_std_error) = (Some(1.0), error);
    }
    let settings = FitSettings {
        mu: args.mu.unwrap_or(1.0),
        mu_std_error: args.mu_std_error,
        curves: args.plot.is_some() || folder.is_some(),
        ..args.options.settings(&set_up)?
    };
    let options = FitOptions::new(settings)?;
    let range = args.search.range()?;
    let given = args.options.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.plot.as_deref().map_or(Ok(()), figure_files::check_path)?;
    let mixtures = args.mixtures.as_deref().map(read_mixtures).transpose()?;
    let MeasurementFile { materials, notes } = output.read_measurements(&args.measurements)?;
    let assumed = set_up.assumed(&materials);
    let materials = set_up.apply_to(materials)?;
    let own = folder.as_ref().and_then(|folder| folder.dictionary.clone());
    let own = own.map(|(name, grid)| Wanted::new(name, grid));
    let request = MeasureRequest {
        dictionary: String::new(),
        materials: materials.iter().map(Into::into).collect(),
        options: Some((&options).into()),
        search_mu: args.mu.is_none().then(|| range.into()),
        common_g: !args.free_g,
        mixtures: mixtures.iter().flat_map(Mixtures::all).map(Into::into).collect(),
    };
    let (dictionary, found) = ask(global, given, own, &request).await?;
    if mixtures.is_some() && found.unmixed.is_none() {
        bail!("the coordinator is too old to fit mixtures: upgrade it");
    }
    let pictures = match &args.plot {
        Some(path) => figure_files::write_fits(&found.materials, path)?,
        None => Vec::new(),
    };
    if let Some(folder) = &args.output {
        write_folder(folder, &found).with_context(|| format!("writing {}", folder.display()))?;
    }
    let options = options.with_mu(found.common.mu, found.common.mu_std_error.min(1.0))?;
    let told = || {
        let assumed = assumed.text(options.settings());
        let report = Report { fits: &found.materials, assumed, bound: args.bound };
        let budget = folder.as_ref().and_then(|_| budget_text(&found.materials));
        let budget = budget.map_or_else(String::new, |text| format!("\n\n{text}"));
        text(&found, &report, args.output.as_deref(), &pictures) + &budget
    };
    let report = match &folder {
        Some(folder) => folder.complete(&found.materials, found.common.mu, &told())?,
        None => None,
    };
    let data = data(UsedOptions::new(&dictionary, &options, &assumed), &found, &notes);
    output.print("measure", &data, || {
        let completed = report.map_or_else(String::new, |path| format!("\nadded to {}", path.display()));
        told() + &completed
    })
}

/// Computes the dictionary where it is lacking, and asks. Returns the dictionary's name, too.
async fn ask(
    global: &Global,
    given: Option<&String>,
    own: Option<Wanted>,
    request: &MeasureRequest,
) -> Result<(String, Found)> {
    let mut wanted = own;
    if wanted.is_none() && given.is_none() {
        wanted = chosen_dictionary::of_an_empty_folder(global)?.inspect(|wanted| announce(global, wanted));
    }
    loop {
        match ask_once(global, given, wanted.as_ref(), request).await? {
            Asked::Answered(dictionary, found) => return Ok((dictionary, *found)),
            Asked::Lacks(lacking) => {
                announce(global, &lacking);
                wanted = Some(lacking);
            }
        }
    }
}

enum Asked {
    Answered(String, Box<Found>),
    Lacks(Wanted),
}

async fn ask_once(
    global: &Global,
    given: Option<&String>,
    wanted: Option<&Wanted>,
    request: &MeasureRequest,
) -> Result<Asked> {
    let purpose = if wanted.is_some() { Purpose::Compute } else { Purpose::Ask };
    with_farm(global, purpose, async |connection| {
        let dictionary = if let Some(Wanted { name, grid, .. }) = wanted {
            submit::ensure(connection, name, grid, global.quiet).await?;
            name.to_string()
        } else {
            match chosen_dictionary::or_lacking(connection, given).await? {
                Chosen::Complete(name) => name,
                Chosen::Lacking(lacking) => return Ok(Asked::Lacks(lacking)),
            }
        };
        let request = MeasureRequest { dictionary: dictionary.clone(), ..request.clone() };
        let fits = connection.fits();
        let found = tokio::select! {
            biased;
            // The computation has taken signals over, so that they end nothing by themselves any more.
            () = interrupted(), if wanted.is_some() => return Err(Interrupted.into()),
            found = fits.measure(request) => found?.into_inner(),
        };
        Ok(Asked::Answered(dictionary, Box::new(found.try_into()?)))
    })
    .await
}

fn announce(global: &Global, wanted: &Wanted) {
    let Wanted { name, grid, records_done } = wanted;
    let total = grid.record_count();
    if !global.quiet {
        tell(format_args!(
            "farmctl: dictionary {name} is not complete in {}: {} of its {} records are computed first",
            global.data.display(),
            grouped(total.saturating_sub(*records_done) as u64),
            grouped(total as u64)
        ));
    }
}

/// Why an answer may lack what this program shows.
pub(super) const OLDER: &str = "the farm's answer does not tell what was chosen for all channels: its coordinator is \
                                older than this farmctl; upgrade it";

/// A checked answer.
pub(crate) struct Found {
    /// The paper's curve; none if the scale factor was given or the likelihood was maximised.
    pub(crate) scale: Option<ScaleCurve>,
    pub(crate) common: Common,
    pub(crate) materials: Vec<MaterialFit>,
    /// None if no mixtures were told.
    pub(crate) unmixed: Option<Unmixed>,
}

impl TryFrom<MeasureResponse> for Found {
    type Error = anyhow::Error;

    fn try_from(answer: MeasureResponse) -> Result<Self, Self::Error> {
        Ok(Self {
            scale: answer.scale.map(ScaleCurve::try_from).transpose()?,
            common: answer.common.context(OLDER)?.try_into()?,
            materials: answer.materials.into_iter().map(MaterialFit::try_from).collect::<Result<_, _>>()?,
            unmixed: answer.unmixed.map(Unmixed::try_from).transpose()?,
        })
    }
}

fn text(found: &Found, report: &Report, folder: Option<&Path>, pictures: &[PathBuf]) -> String {
    let mut text = format!("{}\n\n{}", common_text(&found.common), fits_text(report));
    if let Some(unmixed) = &found.unmixed {
        text += &format!("\n\n{}", inks_text(unmixed));
    }
    text += &figure_files::drawn(pictures);
    if let Some(folder) = folder {
        text += &format!("\nwritten to {}: table.csv, media.py, media.xml, media.pbrt", folder.display());
    }
    text
}

/// Table and media for renderers, as files with their names.
pub(crate) fn media_files(fits: &[MaterialFit]) -> Result<[(&'static str, String); 4]> {
    Ok([
        ("table.csv", table_csv(fits)?),
        ("media.py", renderers::mitsuba_dict(fits)),
        ("media.xml", renderers::mitsuba_xml(fits)),
        ("media.pbrt", renderers::pbrt(fits)),
    ])
}

fn write_folder(folder: &Path, found: &Found) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for (name, text) in media_files(&found.materials)? {
        write_whole(&folder.join(name), text.as_bytes()).context(name)?;
    }
    Ok(())
}

pub(super) fn data<'a>(options: UsedOptions<'a>, found: &'a Found, notes: &'a [Note]) -> impl Serialize {
    #[derive(Serialize)]
    struct Data<'a> {
        #[serde(flatten)]
        options: UsedOptions<'a>,
        /// Null if every channel has its own.
        common_g: Option<f64>,
        common: &'a Common,
        /// Null if the scale factor was given or the likelihood was maximised.
        scale: Option<&'a ScaleCurve>,
        materials: &'a [MaterialFit],
        /// What was assumed when the file was read, and what looks suspicious in it.
        notes: &'a [Note],
        #[serde(skip_serializing_if = "Option::is_none")]
        unmixed: Option<&'a Unmixed>,
    }
    Data {
        options,
        common_g: found.common.g,
        common: &found.common,
        scale: found.scale.as_ref(),
        materials: &found.materials,
        notes,
        unmixed: found.unmixed.as_ref(),
    }
}
