//! Generates both conversions of types whose fields are those of their messages, and provides adaptors for fields that
//! differ.
//!
//! An adaptor is a module with `to_wire` and `from_wire`, which gets the field's name for its errors.

use optics_model::Invalid;
use optics_model::invalid::Result;

/// `mirror!(Type as Message { field, field: adaptor })` makes `From<Type>` for the message and `TryFrom<Message>` for the
/// type, `as Message` being left out where the names are the same. A field without an adaptor is moved as it is, and a
/// type with private fields names its checking constructor: `mirror!(Type::new(field, field))`.
macro_rules! mirror {
    ($type:ident { $($fields:tt)+ }) => { mirror!($type as $type { $($fields)+ }); };
    ($type:ident as $message:ident { $($field:ident $(: $adaptor:ident)?),+ $(,)? }) => {
        impl From<$type> for $crate::wire::$message {
            fn from(model: $type) -> Self {
                let $type { $($field),+ } = model;
                Self { $($field: mirror!(@to_wire $field $($adaptor)?)),+ }
            }
        }

        impl TryFrom<$crate::wire::$message> for $type {
            type Error = optics_model::Invalid;

            fn try_from(message: $crate::wire::$message) -> optics_model::Result<Self> {
                let $crate::wire::$message { $($field),+ } = message;
                Ok(Self { $($field: mirror!(@from_wire $field $($adaptor)?)),+ })
            }
        }
    };
    ($type:ident :: $new:ident ( $($field:ident),+ )) => {
        impl From<$type> for $crate::wire::$type {
            fn from(model: $type) -> Self {
                Self { $($field: model.$field()),+ }
            }
        }

        impl TryFrom<$crate::wire::$type> for $type {
            type Error = optics_model::Invalid;

            fn try_from(message: $crate::wire::$type) -> optics_model::Result<Self> {
                Self::$new($(message.$field),+)
            }
        }
    };
    (@to_wire $field:ident) => { $field };
    (@to_wire $field:ident $adaptor:ident) => { $adaptor::to_wire($field) };
    (@from_wire $field:ident) => { $field };
    (@from_wire $field:ident $adaptor:ident) => { $adaptor::from_wire(stringify!($field), $field)? };
}

/// `mirror_enum!(Type { Variant, Variant } or Variant)` numbers the variants as the enum of the same name on the wire
/// does. The variant after `or` represents the unspecified value and those of newer versions; without `or`, such values
/// have no variant.
macro_rules! mirror_enum {
    ($type:ident { $($variant:ident),+ $(,)? } $(or $other:ident)?) => {
        impl From<$type> for $crate::wire::$type {
            fn from(model: $type) -> Self {
                match model {
                    $($type::$variant => Self::$variant,)+
                    $($type::$other => Self::Unspecified,)?
                }
            }
        }

        impl $crate::convert::mirror::Numbered for $type {
            fn number(self) -> i32 {
                $crate::wire::$type::from(self).into()
            }

            fn of_number(number: i32) -> Option<Self> {
                match $crate::wire::$type::try_from(number) {
                    $(Ok($crate::wire::$type::$variant) => Some(Self::$variant),)+
                    _ => None $(.or(Some(Self::$other)))?,
                }
            }
        }
    };
}

pub(super) use {mirror, mirror_enum};

/// An enum that is a number on the wire.
pub(super) trait Numbered: Sized {
    fn number(self) -> i32;

    /// None for a number that has no meaning in this version.
    fn of_number(number: i32) -> Option<Self>;
}

/// The value of a required field.
pub(super) fn required<T>(field: &str, value: Option<T>) -> Result<T> {
    value.ok_or_else(|| Invalid::new(field, "nothing", "a value is needed"))
}

/// An adaptor for a message that is required.
pub(super) mod required {
    use super::{Invalid, Result};

    #[expect(clippy::unnecessary_wraps, reason = "a field that is a message is an option on the wire")]
    pub fn to_wire<M, W: From<M>>(value: M) -> Option<W> {
        Some(value.into())
    }

    pub fn from_wire<M: TryFrom<W, Error = Invalid>, W>(field: &str, message: Option<W>) -> Result<M> {
        super::required(field, message)?.try_into()
    }
}

/// An adaptor for a message that may be absent.
pub(super) mod optional {
    use super::{Invalid, Result};

    pub fn to_wire<M, W: From<M>>(value: Option<M>) -> Option<W> {
        value.map(Into::into)
    }

    pub fn from_wire<M: TryFrom<W, Error = Invalid>, W>(_: &str, message: Option<W>) -> Result<Option<M>> {
        message.map(TryInto::try_into).transpose()
    }
}

/// An adaptor for a list of messages.
pub(super) mod list {
    use super::{Invalid, Result};
    use optics_model::invalid::each;

    pub fn to_wire<M, W: From<M>>(values: Vec<M>) -> Vec<W> {
        values.into_iter().map(Into::into).collect()
    }

    pub fn from_wire<M: TryFrom<W, Error = Invalid>, W>(field: &str, messages: Vec<W>) -> Result<Vec<M>> {
        each(field, messages, TryInto::try_into)
    }
}

/// An adaptor for a list of messages. Those with an enum's value from a newer version are left out: without its name
/// and unit their numbers have no meaning.
pub(super) mod known_ones {
    pub use super::list::to_wire;
    use super::{Invalid, Result};

    #[expect(clippy::unnecessary_wraps, reason = "adaptors have one form")]
    pub fn from_wire<M: TryFrom<W, Error = Invalid>, W>(_: &str, messages: Vec<W>) -> Result<Vec<M>> {
        Ok(messages.into_iter().filter_map(|message| message.try_into().ok()).collect())
    }
}

/// An adaptor for a value of an enum.
pub(super) mod number {
    use super::{Invalid, Numbered, Result};

    pub fn to_wire<M: Numbered>(value: M) -> i32 {
        value.number()
    }

    pub fn from_wire<M: Numbered>(field: &str, number: i32) -> Result<M> {
        let known = M::of_number(number);
        known.ok_or_else(|| {
            Invalid::new(field, number, format!("a {field} that this version knows is needed"))
        })
    }
}

/// An adaptor for a value of an enum that may be absent; a value of a newer version counts as absent.
pub(super) mod optional_number {
    use super::{Numbered, Result};

    pub fn to_wire<M: Numbered>(value: Option<M>) -> i32 {
        value.map_or(0, Numbered::number)
    }

    #[expect(clippy::unnecessary_wraps, reason = "adaptors have one form")]
    pub fn from_wire<M: Numbered>(_: &str, number: i32) -> Result<Option<M>> {
        Ok(M::of_number(number))
    }
}

/// An adaptor for the number of a record, which may be absent.
pub(super) mod optional_index {
    use super::Result;

    pub fn to_wire(index: Option<usize>) -> Option<u32> {
        index.map(|i| i as u32)
    }

    #[expect(clippy::unnecessary_wraps, reason = "adaptors have one form")]
    pub fn from_wire(_: &str, index: Option<u32>) -> Result<Option<usize>> {
        Ok(index.map(|i| i as usize))
    }
}

/// An adaptor for a list that is empty on the wire if it is absent.
pub(super) mod absent_if_empty {
    use super::Result;

    pub fn to_wire(values: Option<Vec<f64>>) -> Vec<f64> {
        values.unwrap_or_default()
    }

    #[expect(clippy::unnecessary_wraps, reason = "adaptors have one form")]
    pub fn from_wire(_: &str, values: Vec<f64>) -> Result<Option<Vec<f64>>> {
        Ok((!values.is_empty()).then_some(values))
    }
}

/// An adaptor for the nine numbers of a symmetric matrix.
pub(super) mod matrix {
    use super::{Invalid, Result};

    pub fn to_wire(matrix: [[f64; 3]; 3]) -> Vec<f64> {
        matrix.as_flattened().to_vec()
    }

    #[expect(clippy::needless_pass_by_value, reason = "adaptors take the field")]
    pub fn from_wire(field: &str, numbers: Vec<f64>) -> Result<[[f64; 3]; 3]> {
        let count = numbers.len();
        let matrix = match numbers.as_chunks::<3>() {
            (rows, []) => rows.try_into().ok(),
            _ => None,
        };
        matrix.ok_or_else(|| Invalid::new(field, count, "nine numbers are needed"))
    }
}
