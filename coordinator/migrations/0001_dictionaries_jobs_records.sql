CREATE TABLE dictionaries (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    -- farm.v1.Grid in protobuf encoding.
    grid BLOB NOT NULL,
    grid_digest BLOB NOT NULL CHECK (length(grid_digest) = 32),
    created_unix_ms INTEGER NOT NULL
) STRICT;

-- Jobs that have ended; a job without a row has still to be computed.
CREATE TABLE jobs (
    dictionary_id INTEGER NOT NULL REFERENCES dictionaries (id),
    job INTEGER NOT NULL,
    -- BLAKE3 of the job's records, if it is done.
    records_digest BLOB CHECK (length(records_digest) = 32),
    -- Why the job was given up, if it has failed.
    failure TEXT,
    PRIMARY KEY (dictionary_id, job),
    CHECK ((records_digest IS NULL) <> (failure IS NULL))
) STRICT, WITHOUT ROWID;

-- Appended in the order of completion, so that pages fill up; found by dictionary and number.
CREATE TABLE records (
    id INTEGER PRIMARY KEY,
    dictionary_id INTEGER NOT NULL REFERENCES dictionaries (id),
    record INTEGER NOT NULL,
    -- For each channel: radiance factor, d/d albedo, d/d sigma_t (the last two if the grid asks for
    -- them), each as values, then standard errors, in 32-bit floats, little endian.
    profiles BLOB NOT NULL,
    UNIQUE (dictionary_id, record)
) STRICT;
