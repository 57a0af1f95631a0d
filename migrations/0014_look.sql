-- The look pins a campaign as its renderer does. Until looks had names, every worker drew textures
-- as MuJoCo 3.3.3 does.
ALTER TABLE worker ADD COLUMN look TEXT NOT NULL DEFAULT 'mujoco-3.3.3';
ALTER TABLE provenance ADD COLUMN look TEXT NOT NULL DEFAULT 'mujoco-3.3.3';
ALTER TABLE campaign ADD COLUMN look TEXT;
UPDATE campaign SET look = 'mujoco-3.3.3' WHERE renderer IS NOT NULL;
