-- A campaign says what the robot does while its policy's answer is under way. Earlier ones
-- wait; so does every result whose policy settings do not say otherwise.
ALTER TABLE campaign ADD COLUMN execution TEXT NOT NULL DEFAULT 'wait';
