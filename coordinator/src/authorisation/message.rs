//! Finds the boundaries of the messages of a gRPC call.

/// Bytes before each message: whether it is compressed, and its length.
const PREFIX: usize = 5;

/// The message that is being received.
#[derive(Debug, Default)]
pub(super) struct Message {
    prefix: Vec<u8>,
    /// Bytes that have been received of it, with its prefix.
    come: usize,
    /// Missing bytes of its content, once its prefix is complete.
    lacks: usize,
}

impl Message {
    /// Counts received bytes; returns whether a message has ended in them.
    pub fn take(&mut self, mut data: &[u8]) -> bool {
        let mut ended = false;
        while !data.is_empty() {
            if self.is_between() {
                self.come = 0;
            }
            let to_prefix = (PREFIX - self.prefix.len()).min(data.len());
            let (prefix, rest) = data.split_at(to_prefix);
            self.prefix.extend_from_slice(prefix);
            self.come += to_prefix;
            if to_prefix > 0
                && let [_, a, b, c, d] = self.prefix[..]
            {
                self.lacks = u32::from_be_bytes([a, b, c, d]) as usize;
            }
            let content = self.lacks.min(rest.len());
            self.come += content;
            self.lacks -= content;
            data = &rest[content..];
            if self.prefix.len() == PREFIX && self.lacks == 0 {
                self.prefix.clear();
                ended = true;
            }
        }
        ended
    }

    /// Bytes that have been received of the current message or, between two messages, of the last one.
    pub fn bytes(&self) -> usize {
        self.come
    }

    /// Whether the last message is complete and the next has not begun.
    pub fn is_between(&self) -> bool {
        self.prefix.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A message ends where its length prefix declares, whatever the size of the pieces that arrive.
    #[test]
    fn messages_end_where_their_prefixes_declare() {
        let lengths = [3_u32, 0, 1, 261];
        let bytes: Vec<u8> = lengths
            .iter()
            .flat_map(|n| [vec![0], n.to_be_bytes().to_vec(), vec![9; *n as usize]])
            .flatten()
            .collect();
        let ends = [8, 13, 19, 285];
        for piece in [1, 2, 5, 7] {
            let (mut message, mut at) = (Message::default(), 0);
            for data in bytes.chunks(piece) {
                let ended = message.take(data);
                let expected = ends.iter().any(|end| (at + 1..=at + data.len()).contains(end));
                at += data.len();
                assert_eq!(ended, expected, "pieces of {piece}, up to {at}");
                assert_eq!(message.is_between(), ends.contains(&at));
            }
            assert_eq!(message.bytes(), 266);
        }
    }
}
