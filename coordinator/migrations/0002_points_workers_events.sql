-- "FARM": tells this program's databases from others.
PRAGMA application_id = 0x4641524D;

-- The first schema's records belong to dictionaries; they are moved to `points` and `records` when the program first
-- opens the database, since that takes the grids' albedos.
ALTER TABLE records RENAME TO records_of_dictionaries;

-- Priority, and what people want: 'run', 'pause' or 'cancel', with the reason given.
ALTER TABLE dictionaries ADD COLUMN priority INTEGER NOT NULL DEFAULT 0;
ALTER TABLE dictionaries ADD COLUMN desire TEXT NOT NULL DEFAULT 'run' CHECK (desire IN ('run', 'pause', 'cancel'));
ALTER TABLE dictionaries ADD COLUMN reason TEXT NOT NULL DEFAULT '';

-- Processes that have registered; one that computed wrongly is fenced off.
CREATE TABLE workers (
    id INTEGER PRIMARY KEY,
    instance TEXT NOT NULL UNIQUE,
    label TEXT NOT NULL,
    fenced TEXT
) STRICT;

-- Sets of walks. Their records serve every dictionary that asks for the same.
CREATE TABLE points (
    id INTEGER PRIMARY KEY,
    -- BLAKE3 of scene, transport point, walks, seed, derivatives and physics version.
    identity BLOB NOT NULL UNIQUE CHECK (length(identity) = 32)
) STRICT;

-- Who computed a point, or parts of it.
CREATE TABLE contributions (
    point_id INTEGER NOT NULL REFERENCES points (id),
    worker_id INTEGER NOT NULL REFERENCES workers (id),
    PRIMARY KEY (point_id, worker_id)
) STRICT, WITHOUT ROWID;
CREATE INDEX contributions_of_worker ON contributions (worker_id);

-- Appended in the order of completion, so that pages fill up; found by point and albedo.
CREATE TABLE records (
    id INTEGER PRIMARY KEY,
    point_id INTEGER NOT NULL REFERENCES points (id),
    albedo REAL NOT NULL,
    -- For each channel: radiance factor, d/d albedo, d/d sigma_t (the last two if the grid asks for
    -- them), each as values, then standard errors, in 32-bit floats, little endian.
    profiles BLOB NOT NULL,
    UNIQUE (point_id, albedo)
) STRICT;

-- Sums of the blocks of divided jobs, until all are there. Row -1 - n holds the first n blocks merged.
CREATE TABLE sums (
    point_id INTEGER NOT NULL REFERENCES points (id),
    block INTEGER NOT NULL,
    -- Sums, then squares: 64-bit floats, little endian.
    sums BLOB NOT NULL,
    PRIMARY KEY (point_id, block)
) STRICT;

-- Jobs that have ended; a job without a row has still to be computed.
CREATE TABLE jobs_with_points (
    dictionary_id INTEGER NOT NULL REFERENCES dictionaries (id),
    job INTEGER NOT NULL,
    -- If it is done: its walks and the BLAKE3 of its records, and whether they were there before.
    point_id INTEGER REFERENCES points (id),
    walks INTEGER,
    records_digest BLOB CHECK (length(records_digest) = 32),
    reused INTEGER NOT NULL DEFAULT 0 CHECK (reused IN (0, 1)),
    -- Why the job was given up, if it was; and whether for its workers' silence.
    failure TEXT,
    quarantined INTEGER NOT NULL DEFAULT 0 CHECK (quarantined IN (0, 1)),
    PRIMARY KEY (dictionary_id, job),
    CHECK ((records_digest IS NULL) <> (failure IS NULL))
) STRICT, WITHOUT ROWID;
INSERT INTO jobs_with_points (dictionary_id, job, records_digest, failure)
    SELECT dictionary_id, job, records_digest, failure FROM jobs;
DROP TABLE jobs;
ALTER TABLE jobs_with_points RENAME TO jobs;
CREATE INDEX jobs_of_point ON jobs (point_id);

-- What has happened, for people; the oldest are deleted.
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    unix_ms INTEGER NOT NULL,
    kind TEXT NOT NULL,
    dictionary TEXT NOT NULL,
    job INTEGER,
    worker TEXT NOT NULL,
    message TEXT NOT NULL
) STRICT;
