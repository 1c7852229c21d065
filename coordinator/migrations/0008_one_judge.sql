-- The coordinator itself decides which of two results is right, by computing it: neither confirmations by other machines
-- nor records that were set aside are needed.

-- Whether the coordinator has computed the same records: then they stay if their machine is fenced off.
ALTER TABLE jobs ADD COLUMN verified INTEGER NOT NULL DEFAULT 0 CHECK (verified IN (0, 1));

-- Machines that had confirmed a point: that is no evidence any more.
DELETE FROM contributions WHERE confirmed = 1;
ALTER TABLE contributions DROP COLUMN confirmed;

-- What machines have found, until the coordinator has decided.
ALTER TABLE votes RENAME TO claims;

-- Points that were set aside are computed again already.
DELETE FROM records WHERE point_id IN (SELECT point_id FROM set_aside);
DELETE FROM sums WHERE point_id IN (SELECT point_id FROM set_aside);
DROP TABLE jobs_set_aside;
DROP TABLE set_aside;
DELETE FROM contributions
    WHERE point_id NOT IN (SELECT point_id FROM records) AND point_id NOT IN (SELECT point_id FROM sums)
    AND point_id NOT IN (SELECT point_id FROM jobs WHERE point_id IS NOT NULL);
DELETE FROM points
    WHERE id NOT IN (SELECT point_id FROM records) AND id NOT IN (SELECT point_id FROM sums)
    AND id NOT IN (SELECT point_id FROM jobs WHERE point_id IS NOT NULL);
