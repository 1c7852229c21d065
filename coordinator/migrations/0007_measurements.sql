-- Measurements that users keep: question, answer and grid as one message, with its digest, and texts for lists. `number`
-- grows when a measurement is kept again, so that lists begin with the newest.
CREATE TABLE measurements (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE,
    kept_unix_ms INTEGER NOT NULL,
    owner TEXT NOT NULL,
    title TEXT NOT NULL,
    note TEXT NOT NULL,
    source TEXT NOT NULL,
    command TEXT NOT NULL,
    dictionary TEXT NOT NULL,
    -- One name per line.
    materials TEXT NOT NULL,
    channels INTEGER NOT NULL,
    content BLOB NOT NULL,
    content_digest BLOB NOT NULL
) STRICT;
