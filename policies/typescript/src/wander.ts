/**
 * An example policy: it moves the hand a little at random, keeps it at a
 * constant height, and closes the fingers if the wrist camera's frame is dark.
 * It solves no task; it shows the inputs and outputs of a policy.
 */

import { createHash } from "node:crypto";

/** Numbers per action: translation (3), rotation (3), gripper (-1 open, 1 closed). */
export const ACTION_WIDTH = 7;
/** Actions per answer, all of which are executed. */
export const HORIZON = 4;
/** The requested camera, with the size of its frames in pixels. */
export const CAMERA = { name: "robot0_eye_in_hand", width: 32, height: 32 };

/** Height at which the policy keeps the fingertips, m, world frame. */
const HEIGHT = 1.1;
/** Command per metre of missing height. */
const GAIN = 5;
/** Largest random command. */
const REACH = 0.3;
/** Mean brightness, 0..255, under which the frame is dark. */
const DARK = 60;

/** The inputs of one query. */
export interface Inputs {
  /** RGB, row after row, the bottom row first. */
  rgb: Buffer;
  /** Fingertips, m, world frame. */
  position: number[];
}

/**
 * Returns the next actions, row by row. Random numbers depend only on the rollout's
 * seed and the query's index, so that neither a retry nor another order of requests
 * changes a rollout.
 */
export function act(inputs: Inputs, seed: string, query: number): number[] {
  const rise = clip(GAIN * (HEIGHT - (inputs.position[2] ?? HEIGHT)));
  const gripper = mean(inputs.rgb) < DARK ? 1 : -1;
  const random = uniform(seed, query, 2 * HORIZON);
  return Array.from({ length: HORIZON }, (_, at) => [
    REACH * (random[2 * at] ?? 0),
    REACH * (random[2 * at + 1] ?? 0),
    rise,
    ...[0, 0, 0],
    gripper,
  ]).flat();
}

/** Returns up to eight numbers in -1..1, derived from a hash. */
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
