-- The perturbation as realised, axis by axis: `camera:HEX,sensor:HEX`, SHA-256
-- each, and the empty text for a nominal rollout. One digest over all axes at
-- once, as it was kept so far, cannot show that an axis alone and the same axis
-- in a combination were realised identically.
--
-- NULL in results that were stored before: of those it is not known.
ALTER TABLE result DROP COLUMN perturbation_digest;
ALTER TABLE result ADD COLUMN perturbation_digests TEXT CHECK
    (perturbation_digests = '' OR (perturbation_digests GLOB '[a-z]*:[0-9a-f]*'
        AND perturbation_digests NOT GLOB '*[^0-9a-z:,]*'));
