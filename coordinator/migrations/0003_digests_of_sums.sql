-- Blocks with a digest each, so that damage is noticed. Those that there are have none: they are computed again.
DROP TABLE sums;
DELETE FROM contributions
    WHERE point_id NOT IN (SELECT point_id FROM records) AND point_id NOT IN (SELECT point_id FROM jobs WHERE point_id IS NOT NULL);
DELETE FROM points
    WHERE id NOT IN (SELECT point_id FROM records) AND id NOT IN (SELECT point_id FROM jobs WHERE point_id IS NOT NULL);

-- Sums of the blocks of divided jobs, until all are there. Row -1 - n holds the first n blocks merged.
CREATE TABLE sums (
    point_id INTEGER NOT NULL REFERENCES points (id),
    block INTEGER NOT NULL,
    -- Sums, then squares: 64-bit floats, little endian.
    sums BLOB NOT NULL,
    -- BLAKE3 of the sums.
    digest BLOB NOT NULL CHECK (length(digest) = 32),
    PRIMARY KEY (point_id, block)
) STRICT;
