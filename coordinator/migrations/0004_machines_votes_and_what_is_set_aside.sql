-- Random bytes that nobody outside knows.
CREATE TABLE secrets (
    name TEXT PRIMARY KEY,
    value BLOB NOT NULL CHECK (length(value) = 32)
) STRICT, WITHOUT ROWID;

-- Machines that workers came from, by token and address. Rows from before are processes: nobody comes as one of them again,
-- but results are traced to them.
ALTER TABLE workers RENAME COLUMN instance TO identity;
ALTER TABLE workers ADD COLUMN token TEXT NOT NULL DEFAULT '';
ALTER TABLE workers ADD COLUMN address TEXT NOT NULL DEFAULT '';
-- What the worker says that tells its machine from others.
ALTER TABLE workers ADD COLUMN host TEXT NOT NULL DEFAULT '';

-- Whether it found the same when it checked the point; otherwise it computed the point or a part of it. Of a point that
-- is not divided all but one have checked it.
ALTER TABLE contributions ADD COLUMN confirmed INTEGER NOT NULL DEFAULT 0 CHECK (confirmed IN (0, 1));
UPDATE contributions SET confirmed = 1
    WHERE point_id IN (SELECT point_id FROM jobs WHERE walks <= 1000000)
    AND worker_id > (SELECT min(worker_id) FROM contributions AS others WHERE others.point_id = contributions.point_id);

-- Checks that a restart must not forget: disputes, and blocks whose sums are merged. In the order of the votes; the first
-- is about what is stored.
CREATE TABLE votes (
    dictionary_id INTEGER NOT NULL REFERENCES dictionaries (id),
    job INTEGER NOT NULL,
    block INTEGER NOT NULL,
    place INTEGER NOT NULL,
    worker_id INTEGER REFERENCES workers (id),
    -- BLAKE3 of the records, or of the block's sums.
    digest BLOB NOT NULL CHECK (length(digest) = 32),
    PRIMARY KEY (dictionary_id, job, block, place)
) STRICT, WITHOUT ROWID;

-- Points that are not believed, kept until they have been computed again. `points` has a random identity for them, so that
-- nobody finds them by theirs.
CREATE TABLE set_aside (
    point_id INTEGER PRIMARY KEY REFERENCES points (id),
    identity BLOB NOT NULL CHECK (length(identity) = 32),
    -- For whose sake; none if the records were found to be damaged.
    worker_id INTEGER REFERENCES workers (id)
) STRICT;

-- The jobs that they had ended.
CREATE TABLE jobs_set_aside (
    point_id INTEGER NOT NULL REFERENCES set_aside (point_id),
    dictionary_id INTEGER NOT NULL REFERENCES dictionaries (id),
    job INTEGER NOT NULL,
    walks INTEGER,
    records_digest BLOB NOT NULL CHECK (length(records_digest) = 32),
    PRIMARY KEY (dictionary_id, job, point_id)
) STRICT, WITHOUT ROWID;
