//! Encodes and decodes messages, and bounds the memory that decoded requests take.
//!
//! A message of two bytes may become a structure of two hundred, so that a decoded message could be a hundred times as
//! large as its bytes. Therefore the parts of a request are counted in its bytes before it is decoded, and its texts
//! are checked.

use std::collections::HashMap;
use std::marker::PhantomData;
use std::sync::LazyLock;

use optics_model::Invalid;
use prost::bytes::Buf as _;
use prost::encoding::{WireType, decode_key, decode_varint};
use prost::{Message, Name};
use prost_types::FieldDescriptorProto;
use prost_types::field_descriptor_proto::{Label, Type};
use tonic::Status;
use tonic::codec::{Codec, DecodeBuf, Decoder};
use tonic_prost::{ProstCodec, ProstDecoder, ProstEncoder};

use crate::convert::{check_text, to_status};
use crate::wire;

/// Most memory that a nested message or a text takes in addition to its content.
const PART_BYTES: usize = 256;
/// Memory that the parts of any request may take.
const FREE_BYTES: usize = 1 << 20;
/// Additional memory that the parts may take for each byte of the request.
const FACTOR: usize = 4;
/// Deepest nesting of messages.
const DEPTH: usize = 16;

/// The codec of all services.
#[derive(Debug, Clone)]
pub struct BoundedCodec<E, D>(PhantomData<(E, D)>);

impl<E, D> Default for BoundedCodec<E, D> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<E, D> Codec for BoundedCodec<E, D>
where
    E: Message + Send + 'static,
    D: Message + Name + Default + Send + 'static,
{
    type Encode = E;
    type Decode = D;
    type Encoder = ProstEncoder<E>;
    type Decoder = BoundedDecoder<D>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<E, D>::default().encoder()
    }

    fn decoder(&mut self) -> Self::Decoder {
        BoundedDecoder(ProstCodec::<E, D>::default().decoder())
    }
}

/// Decodes messages, and refuses requests that would grow too much by it.
#[derive(Debug, Clone)]
pub struct BoundedDecoder<D>(ProstDecoder<D>);

impl<D: Message + Name + Default> Decoder for BoundedDecoder<D> {
    type Item = D;
    type Error = Status;

    fn decode(&mut self, buf: &mut DecodeBuf<'_>) -> Result<Option<D>, Status> {
        // A message is contiguous in the buffer.
        if D::NAME.ends_with("Request") && buf.chunk().len() == buf.remaining() {
            check::<D>(buf.chunk())?;
        }
        self.0.decode(buf)
    }
}

/// Refuses a message whose parts would take much more memory than its bytes, or that has a text that is not allowed.
fn check<D: Name>(bytes: &[u8]) -> Result<(), Status> {
    let most = FREE_BYTES.saturating_add(bytes.len().saturating_mul(FACTOR)) / PART_BYTES;
    let mut parts = PartBudget { left: most };
    parts.look_at(bytes, SCHEMA.get(&D::full_name()), DEPTH).map_err(|refused| match refused {
        Refused::TooMany => Status::resource_exhausted(format!(
            "{} = {} bytes is not valid: at most {most} messages and texts may be in it",
            D::NAME,
            bytes.len()
        )),
        Refused::Text(invalid) => to_status(&invalid),
        Refused::NotRead => Status::internal(format!("{} cannot be decoded", D::NAME)),
    })
}

/// The fields of all messages, by the names of the messages.
static SCHEMA: LazyLock<HashMap<String, Fields>> = LazyLock::new(schema);

/// The fields of a message that hold messages or texts, by their numbers.
type Fields = HashMap<u32, Field>;

struct Field {
    name: String,
    is_repeated: bool,
    content: Content,
}

enum Content {
    Message(String),
    Text,
    Bytes,
}

impl Field {
    /// Its place in a message, as in `layers[2]`.
    fn place(&self, number: u32, before: &[u8]) -> String {
        let earlier = || Entries(before).flatten().filter(|entry| entry.number == number).count();
        if self.is_repeated { format!("{}[{}]", self.name, earlier()) } else { self.name.clone() }
    }
}

enum Refused {
    TooMany,
    Text(Invalid),
    NotRead,
}

impl Refused {
    fn within(self, place: impl FnOnce() -> String) -> Self {
        match self {
            Self::Text(invalid) => Self::Text(invalid.within(place())),
            other => other,
        }
    }
}

/// The number of parts that a message may still have.
struct PartBudget {
    left: usize,
}

impl PartBudget {
    fn look_at(&mut self, bytes: &[u8], fields: Option<&Fields>, depth: usize) -> Result<(), Refused> {
        let depth = depth.checked_sub(1).ok_or(Refused::NotRead)?;
        let mut entries = Entries(bytes);
        loop {
            let before = &bytes[..bytes.len() - entries.0.len()];
            let Some(entry) = entries.next() else { return Ok(()) };
            let FieldEntry { number, content } = entry?;
            let field = fields.and_then(|fields| fields.get(&number));
            let (Some(content), Some(field)) = (content, field) else { continue };
            self.left = self.left.checked_sub(1).ok_or(Refused::TooMany)?;
            match &field.content {
                Content::Message(message) => self
                    .look_at(content, SCHEMA.get(message), depth)
                    .map_err(|refused| refused.within(|| field.place(number, before)))?,
                Content::Text => check_text(&field.name, content)
                    .map_err(|invalid| Refused::Text(invalid.renamed(field.place(number, before))))?,
                Content::Bytes => {}
            }
        }
    }
}

/// The entries of an encoded message, one after the other.
struct Entries<'a>(&'a [u8]);

/// A field's number, and its content if that has a length.
struct FieldEntry<'a> {
    number: u32,
    content: Option<&'a [u8]>,
}

impl<'a> Iterator for Entries<'a> {
    type Item = Result<FieldEntry<'a>, Refused>;

    fn next(&mut self) -> Option<Self::Item> {
        (!self.0.is_empty()).then(|| self.read().ok_or(Refused::NotRead))
    }
}

impl<'a> Entries<'a> {
    fn read(&mut self) -> Option<FieldEntry<'a>> {
        let (number, wire_type) = decode_key(&mut self.0).ok()?;
        let has_length = wire_type == WireType::LengthDelimited;
        let length = match wire_type {
            WireType::Varint => decode_varint(&mut self.0).map(|_| 0).ok()?,
            WireType::SixtyFourBit => 8,
            WireType::ThirtyTwoBit => 4,
            WireType::LengthDelimited => usize::try_from(decode_varint(&mut self.0).ok()?).ok()?,
            WireType::StartGroup | WireType::EndGroup => return None,
        };
        let (content, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(FieldEntry { number, content: has_length.then_some(content) })
    }
}

fn schema() -> HashMap<String, Fields> {
    let set = prost_types::FileDescriptorSet::decode(wire::DESCRIPTORS)
        .expect("the descriptors were made by the compiler");
    let messages = set.file.iter().flat_map(|file| file.message_type.iter().map(|m| (file.package(), m)));
    let fields = messages.map(|(package, message)| {
        let fields = message.field.iter().filter_map(field);
        (format!("{package}.{}", message.name()), fields.collect())
    });
    fields.collect()
}

fn field(field: &FieldDescriptorProto) -> Option<(u32, Field)> {
    let content = match field.r#type() {
        Type::Message => Content::Message(field.type_name().trim_start_matches('.').to_owned()),
        Type::String => Content::Text,
        Type::Bytes => Content::Bytes,
        _ => return None,
    };
    let is_repeated = field.label() == Label::Repeated;
    Some((field.number() as u32, Field { name: field.name().to_owned(), is_repeated, content }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A question with this many empty profiles: two bytes each.
    fn empty_profiles(profiles: usize) -> wire::FitRequest {
        let profiles = vec![wire::MeasuredProfile::default(); profiles];
        let measurement = wire::Measurement { material: String::new(), profiles };
        wire::FitRequest { measurement: Some(measurement), ..Default::default() }
    }

    /// A message that would grow a hundredfold when decoded is refused.
    #[test]
    fn expanding_message_is_refused_early() {
        let bytes = empty_profiles(1 << 20).encode_to_vec();
        let refused = check::<wire::FitRequest>(&bytes).unwrap_err();
        assert_eq!(refused.code(), tonic::Code::ResourceExhausted);
        assert!(refused.message().starts_with("FitRequest = 209"), "{refused}");
        let small = empty_profiles(1024).encode_to_vec();
        check::<wire::FitRequest>(&small).unwrap();
        assert!(check::<wire::FitRequest>(&small[..small.len() - 1]).is_err(), "it is cut off");
        let request = wire::ProfileRequest { channels: vec![String::new(); 1 << 20], ..Default::default() };
        assert!(check::<wire::ProfileRequest>(&request.encode_to_vec()).is_err(), "texts count");
    }

    /// A text that is not allowed is refused with its place in the message.
    #[test]
    fn invalid_text_is_refused_with_its_place() {
        let layer = |name: &str| wire::Layer { name: name.to_owned(), ..Default::default() };
        let submit = |names: [&str; 3]| {
            let scene = wire::Scene { layers: names.map(layer).into(), ..Default::default() };
            let grid = wire::Grid { scene: Some(scene), ..Default::default() };
            let request = wire::SubmitRequest { grid: Some(grid), ..Default::default() };
            check::<wire::SubmitRequest>(&request.encode_to_vec())
        };
        submit(["glass", "sample", "board"]).unwrap();
        let long = "x".repeat(16_000_000);
        let refused = submit(["glass", "sample", &long]).unwrap_err();
        assert_eq!(refused.code(), tonic::Code::InvalidArgument);
        assert_eq!(
            refused.message(),
            "grid.scene.layers[2].name = 16000000 bytes is not valid: at most 256 bytes are allowed"
        );
        let refused = submit(["glass", "a\u{1b}[2J", "b"]).unwrap_err();
        let place = "grid.scene.layers[1].name = a text with \\u{1b}";
        assert!(refused.message().starts_with(place), "{refused}");
        let channels = vec!["R".to_owned(), "\u{202e}".to_owned()];
        let request = wire::ProfileRequest { channels, ..Default::default() };
        let refused = check::<wire::ProfileRequest>(&request.encode_to_vec()).unwrap_err();
        assert!(refused.message().starts_with("channels[1] = "), "{refused}");
    }

    /// The assumed size of a part is at least that of every message type.
    #[test]
    fn part_size_is_an_upper_bound() {
        let sizes = [
            size_of::<wire::MeasuredProfile>(),
            size_of::<wire::Measurement>(),
            size_of::<wire::Layer>(),
            size_of::<wire::Channel>(),
            size_of::<wire::Mixture>(),
            size_of::<wire::HeldLease>(),
            size_of::<wire::LeaseKey>(),
        ];
        assert!(sizes.into_iter().all(|size| size <= PART_BYTES), "{sizes:?}");
    }
}
