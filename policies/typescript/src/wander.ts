/**
 * A policy that wanders: it moves the hand a little at random, keeps it at a
 * height, and closes the fingers when what is before them is dark. It solves no
 * task; it shows what a policy gets and gives.
 */

import { createHash } from "node:crypto";

/** Numbers per action: translation (3), rotation (3), gripper (-1 open, 1 closed). */
export const ACTION_WIDTH = 7;
/** Actions per answer, all of which are executed. */
export const HORIZON = 4;
/** What is looked at: one camera, in pixels. */
export const CAMERA = { name: "robot0_eye_in_hand", width: 32, height: 32 };

/** Height that the fingertips are kept at, m, world frame. */
const HEIGHT = 1.1;
/** Command per metre of missing height. */
const GAIN = 5;
/** Largest random command. */
const REACH = 0.3;
/** Mean brightness, 0..255, under which the frame is dark. */
const DARK = 60;

/** What one query shows. */
export interface Sight {
  /** RGB, row after row, the bottom row first. */
  rgb: Buffer;
  /** Fingertips, m, world frame. */
  position: number[];
}

/**
 * The next actions, row by row. Chance comes from the rollout's seed and the
 * query's index alone, so that neither a retry nor another order of requests
 * changes a rollout.
 */
export function act(sight: Sight, seed: string, query: number): number[] {
  const rise = clip(GAIN * (HEIGHT - (sight.position[2] ?? HEIGHT)));
  const gripper = mean(sight.rgb) < DARK ? 1 : -1;
  const chance = uniform(seed, query, 2 * HORIZON);
  return Array.from({ length: HORIZON }, (_, at) => [
    REACH * (chance[2 * at] ?? 0),
    REACH * (chance[2 * at + 1] ?? 0),
    rise,
    ...[0, 0, 0],
    gripper,
  ]).flat();
}

/** Numbers in -1..1 from a hash: at most eight. */
function uniform(seed: string, query: number, count: number): number[] {
  const bytes = createHash("sha256").update(`${seed}/${query}`).digest();
  return Array.from({ length: count }, (_, at) => bytes.readInt32LE(4 * at) / 2 ** 31);
}

function mean(bytes: Buffer): number {
  return bytes.reduce((sum, value) => sum + value, 0) / Math.max(1, bytes.length);
}

function clip(value: number): number {
  return Math.min(1, Math.max(-1, value));
}
