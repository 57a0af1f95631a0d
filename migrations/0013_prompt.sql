-- Results hold the prompt that their policy got: a worker takes it from a task file where the
-- manifest row has none. Earlier results do not.
ALTER TABLE result ADD COLUMN prompt TEXT CHECK (prompt <> '');
