//! Arguments for the quantities of a set-up.

use std::path::{Path, PathBuf};

use clap::Args;
use farm_lab::set_up::{ByChannel, Session, SetUp};
use optics_model::quantities::Unit;
use optics_model::with_quantities;
use serde::Deserialize;

/// Heading of the help.
pub(crate) const SET_UP: &str = "Accuracy of the set-up";

macro_rules! arguments {
    ($($name:ident { $unit:ident, $default:literal, $range:tt, $form:ident, $label:literal, $help:literal })+) => {
        /// The set-up, as far as it is not that of single profiles.
        #[derive(Debug, Default, Args, Deserialize)]
        #[serde(default)]
        pub(crate) struct SetUpArgs {
            /// Take the values below from a session file (JSON) where they are not given here.
            #[arg(long, value_name = "FILE", help_heading = SET_UP)]
            #[serde(skip)]
            pub(crate) session: Option<PathBuf>,
            $(
                #[arg(
                    long,
                    value_name = Unit::$unit.placeholder(),
                    allow_negative_numbers = true,
                    help_heading = SET_UP,
                    help = concat!($help, " [default: ", $default, "]"),
                )]
                pub(crate) $name: Option<f64>,
            )+
        }

        impl SetUpArgs {
            /// These values, and those of the session file for quantities without a value here: of the file given by
            /// --session, or else of `session`.
            pub(crate) fn read(&self, session: Option<&Path>) -> anyhow::Result<SetUp> {
                let given = Session { $($name: self.$name.map(ByChannel::All),)+ ..Session::default() };
                SetUp::new(self.session.as_deref().or(session), given)
            }
        }
    };
}

with_quantities!(options arguments);
