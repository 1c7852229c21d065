-- Whose a dictionary is: the name of the token that submitted it; empty where nobody showed one.
ALTER TABLE dictionaries ADD COLUMN owner TEXT NOT NULL DEFAULT '';

-- Who brought an event about, and from where; empty if the farm did.
ALTER TABLE events ADD COLUMN actor TEXT NOT NULL DEFAULT '';
