-- From here on records of a new layout are written beside the old ones, which stay as they are: in `records.profiles`, the
-- standard errors of an estimate are no longer 32-bit floats but two bytes and one for each pixel. Lengths tell the two
-- apart. The tables are the same; a program that knows only the old layout must not take the new one for damage, and
-- refuses a database of a later schema.
SELECT 1;
