//! Lists the quantities of a set-up in one table, from which settings, columns, messages, arguments and checks are made;
//! the tables of the documents are compared with it.

use crate::invalid::{Invalid, Result};

/// Passes rows of the table to the macro `$then`: those of a fit's `options`, those of single `profiles`, or `all`.
/// A row is `name { unit, default, [lowest, highest], form, "label", "help" }`; its group decides where the quantity may
/// stand. The label names its default among the reported assumptions, and is empty where the default is not reported.
#[macro_export]
macro_rules! with_quantities {
    ($which:ident $then:ident) => {
        $crate::with_quantities! { @$which $then
            both {
                thickness_std_error_mm {
                    Length, 0.005, [0.0, 1.0], Once, "thickness",
                    "Standard error of the thickness of each slab"
                }
            }
            profiles {
                origin_mm {
                    Length, 0.0, [-10.0, 10.0], Once, "",
                    "Position of the edge in x"
                }
            }
            both {
                origin_std_error_mm {
                    Length, 0.05, [0.0, 1.0], Once, "origin",
                    "Standard error of the position of the edge in each profile"
                }
                blur_mm {
                    Length, 0.0, [0.0, 1.0], PerChannel, "",
                    "Blur of the camera: standard deviation of a Gaussian in the plane of the sample"
                }
                blur_std_error_mm {
                    Length, 0.03, [0.0, 1.0], PerChannel, "blur",
                    "Standard error of the blur"
                }
            }
            options {
                gain_std_error {
                    Share, 0.003, [0.0, 1.0], Once, "gain",
                    "Standard error of each profile's own gain (exposure, illumination), as a share"
                }
                offset_std_error {
                    RadianceFactor, 0.001, [0.0, 1.0], Once, "zero",
                    "Standard error of each profile's zero (stray light, black level), as a radiance factor"
                }
                slope_std_error {
                    SharePer10Mm, 0.002, [0.0, 1.0], Once, "slope",
                    "Standard error of the slope of the light across each profile, as a share per 10 mm"
                }
                wedge_std_error {
                    SharePer10Mm, 0.04, [0.0, 1.0], Once, "wedge",
                    "Standard error of the slope of each slab's thickness across its profile, as a share per 10 mm"
                }
            }
        }
    };
    (@options $then:ident both { $($a:tt)* } profiles { $($b:tt)* } both { $($c:tt)* } options { $($d:tt)* }) => {
        $then! { $($a)* $($c)* $($d)* }
    };
    (@profiles $then:ident both { $($a:tt)* } profiles { $($b:tt)* } both { $($c:tt)* } options { $($d:tt)* }) => {
        $then! { $($a)* $($b)* $($c)* }
    };
    (@all $then:ident both { $($a:tt)* } profiles { $($b:tt)* } both { $($c:tt)* } options { $($d:tt)* }) => {
        $then! { $($a)* $($b)* $($c)* $($d)* }
    };
}

/// A quantity of a set-up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantity {
    /// Name in settings, columns, messages and files; with hyphens, the option of the command line.
    pub name: &'static str,
    pub unit: Unit,
    /// Value where neither the profile nor the options have one.
    pub default: f64,
    pub lowest: f64,
    pub highest: f64,
    pub form: Form,
    /// Names the default among the reported assumptions; empty where the default is not reported.
    pub label: &'static str,
    pub help: &'static str,
}

/// The form of a quantity in a session file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// One number.
    Once,
    /// One number, or one for each channel.
    PerChannel,
}

/// The unit of a quantity's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    Length,
    Share,
    RadianceFactor,
    SharePer10Mm,
}

macro_rules! table {
    ($($name:ident { $unit:ident, $default:expr, [$lowest:expr, $highest:expr], $form:ident, $label:literal, $help:literal })+) => {
        &[$(Quantity {
            name: stringify!($name),
            unit: Unit::$unit,
            default: $default,
            lowest: $lowest,
            highest: $highest,
            form: Form::$form,
            label: $label,
            help: $help,
        }),+]
    };
}

impl Quantity {
    pub const ALL: &[Self] = with_quantities!(all table);
    /// Quantities in the options of a fit, for all profiles without a value of their own.
    pub const OF_OPTIONS: &[Self] = with_quantities!(options table);
    /// Quantities that a profile may have.
    pub const OF_PROFILES: &[Self] = with_quantities!(profiles table);

    /// Refuses a value out of range.
    pub fn check(&self, value: f64) -> Result<f64> {
        if (self.lowest..=self.highest).contains(&value) {
            Ok(value)
        } else {
            Err(Invalid::new(self.name, value, format!("allowed are {} to {}", self.lowest, self.highest)))
        }
    }

    /// A standard error in readable form, after its label.
    pub fn labelled(&self, value: f64) -> String {
        // 100 × 0.003 has a digit too many.
        let percent = (1e6 * value).round() / 1e4;
        let label = self.label;
        match self.unit {
            Unit::Length => format!("{label} ± {value} mm"),
            Unit::Share => format!("{label} ± {percent} %"),
            Unit::RadianceFactor => format!("{label} ± {value}"),
            Unit::SharePer10Mm => format!("{label} ± {percent} % per 10 mm"),
        }
    }
}

impl Unit {
    /// Placeholder for the value in the help of the command line.
    pub const fn placeholder(self) -> &'static str {
        match self {
            Self::Length => "MM",
            Self::Share | Self::RadianceFactor | Self::SharePer10Mm => "ERROR",
        }
    }
}
