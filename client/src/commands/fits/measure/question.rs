//! Asks a farm for the fit of a measurement, and computes the dictionary that it needs first if that is missing.

use anyhow::{Result, bail};
use farm_lab::measurement_file::Note;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::{self, GetRequest, MeasureRequest};
use optics_model::fit::FitOptions;
use optics_model::scene::Channel;
use optics_model::{Grid, Scene};

use crate::answers::MeasureAnswer;
use crate::cli::Global;
use crate::commands::dictionaries::submit;
use crate::commands::fits::chosen_dictionary::{self, Chosen, WantedDictionary};
use crate::commands::fits::dictionary_notes;
use crate::connection::{Connection, Purpose, patient, with_farm};
use crate::interrupt::{Interrupted, interrupted};

/// A measurement to fit, and the dictionary it is fitted with.
pub(crate) struct Question<'a> {
    /// The named dictionary.
    pub given: Option<&'a String>,
    /// The session's scene, to compare with that of a named dictionary, and with its board.
    pub session: Option<&'a Scene>,
    /// The request; the dictionary's name and the board are set later.
    pub request: MeasureRequest,
}

impl Question<'_> {
    /// Thicknesses of all slabs.
    fn slabs_mm(&self) -> Vec<f64> {
        let profiles = self.request.materials.iter().flat_map(|material| &material.profiles);
        profiles.map(|profile| profile.thickness_mm).collect()
    }

    /// The session's board, if a dictionary is for all boards.
    fn board(&self, dictionary: &str, grid: &Grid) -> Result<Vec<Channel>> {
        if !grid.scene().is_for_all_boards() {
            return Ok(Vec::new());
        }
        let Some(session) = self.session else {
            bail!(
                "dictionary {dictionary} is for all boards, and a measurement file has none: measure the folder of a \
                 session, or name another dictionary with --dictionary"
            );
        };
        Ok(session.channels().to_vec())
    }
}

pub(crate) struct Answer {
    pub dictionary: String,
    /// The board of the question, if the dictionary is for all boards.
    pub board: Vec<wire::Channel>,
    pub grid: Grid,
    pub found: Box<MeasureAnswer>,
    /// On the dictionary.
    pub notes: Vec<Note>,
}

/// Computes the dictionary if it is missing, and measures.
pub(super) async fn ask(
    global: &Global,
    own: Option<WantedDictionary>,
    question: &Question<'_>,
) -> Result<Answer> {
    let mut wanted = own;
    if wanted.is_none() {
        wanted = chosen_dictionary::of_an_empty_folder(global, question.given, &question.slabs_mm())?;
    }
    loop {
        match ask_once(global, wanted.as_ref(), question).await? {
            Asked::Answered(answer) => return Ok(answer),
            Asked::Lacks(lacking) => wanted = Some(lacking),
        }
    }
}

enum Asked {
    Answered(Answer),
    Lacks(WantedDictionary),
}

async fn ask_once(
    global: &Global,
    wanted: Option<&WantedDictionary>,
    question: &Question<'_>,
) -> Result<Asked> {
    let purpose = if wanted.is_some() { Purpose::Compute } else { Purpose::Ask };
    with_farm(global, purpose, async |connection| {
        let dictionary = if let Some(WantedDictionary { name, grid, .. }) = wanted {
            submit::ensure(connection, name, grid, global.quiet).await?;
            name.to_string()
        } else {
            match chosen_dictionary::or_lacking(connection, question.given, &question.slabs_mm()).await? {
                Chosen::Complete(name) => name,
                Chosen::Lacking(lacking) => return Ok(Asked::Lacks(lacking)),
            }
        };
        tokio::select! {
            biased;
            // The computation has installed signal handlers, so signals do not end the process by themselves any more.
            () = interrupted(), if wanted.is_some() => Err(Interrupted.into()),
            answer = answered(connection, dictionary, question) => Ok(Asked::Answered(answer?)),
        }
    })
    .await
}

/// Asks a complete dictionary.
pub(crate) async fn answered(
    connection: &Connection,
    dictionary: String,
    question: &Question<'_>,
) -> Result<Answer> {
    let (request, grid) = addressed(connection, dictionary, question).await?;
    let (dictionary, board) = (request.dictionary.clone(), request.board.clone());
    let named = question.session.filter(|_| question.given.is_some());
    let other = named.and_then(|s| dictionary_notes::other_scene(&dictionary, s, grid.scene()));
    let options = FitOptions::try_from(request.options.clone().unwrap_or_default())?;
    let unused = dictionary_notes::unused_quantities(&dictionary, grid.scene(), options.settings());
    let few = dictionary_notes::few_walks(&dictionary, &grid);
    let notes = other.into_iter().chain(unused).chain(few).collect();
    let mut fits = connection.fits_of("materials", &request.materials)?;
    let found = fits.measure(patient(request)).await?.into_inner();
    Ok(Answer { dictionary, board, grid, found: Box::new(found.try_into()?), notes })
}

/// The request to a dictionary with the board of the question, and the dictionary's grid over that board.
pub(crate) async fn addressed(
    connection: &Connection,
    dictionary: String,
    question: &Question<'_>,
) -> Result<(MeasureRequest, Grid)> {
    let get = GetRequest { name: dictionary.clone() };
    let status = connection.dictionaries().get(get).await?.into_inner();
    let stored = DictionaryStatus::try_from(status)?.grid;
    let board = question.board(&dictionary, &stored)?;
    let request = MeasureRequest {
        dictionary,
        board: board.iter().map(Into::into).collect(),
        ..question.request.clone()
    };
    let grid = if board.is_empty() { stored } else { stored.over_boards(board)? };
    Ok((request, grid))
}
