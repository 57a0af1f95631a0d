-- Results say how much of the goal held, so that policies can be compared by what they
-- nearly did. Earlier ones do not.

-- Predicates of the goal.
ALTER TABLE result ADD COLUMN goal_predicates INTEGER CHECK (goal_predicates > 0);
-- Those that held after the last control step: all of them in a success.
ALTER TABLE result ADD COLUMN goal_at_end INTEGER
    CHECK (goal_at_end BETWEEN 0 AND goal_predicates
        AND (goal_at_end = goal_predicates) = success
        AND (goal_at_end IS NULL) = (goal_predicates IS NULL));
-- The most that held together, from rest to the last control step.
ALTER TABLE result ADD COLUMN goal_at_most INTEGER
    CHECK (goal_at_most BETWEEN goal_at_end AND goal_predicates
        AND (goal_at_most IS NULL) = (goal_predicates IS NULL));
