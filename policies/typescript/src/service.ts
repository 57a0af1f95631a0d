/**
 * The service `rollout.policy.v1.Policy`: versions, sessions, retries and
 * errors. `wander.ts` computes the actions.
 */

import {
  type sendUnaryData,
  type ServerUnaryCall,
  status,
  type UntypedServiceImplementation,
} from "@grpc/grpc-js";

import type { DescribeRequest__Output } from "../generated/rollout/policy/v1/DescribeRequest.js";
import type { DescribeResponse } from "../generated/rollout/policy/v1/DescribeResponse.js";
import type { EndRequest__Output } from "../generated/rollout/policy/v1/EndRequest.js";
import type { EndResponse } from "../generated/rollout/policy/v1/EndResponse.js";
import type { InferRequest__Output } from "../generated/rollout/policy/v1/InferRequest.js";
import type { InferResponse } from "../generated/rollout/policy/v1/InferResponse.js";
import type { ResetRequest__Output } from "../generated/rollout/policy/v1/ResetRequest.js";
import type { ResetResponse } from "../generated/rollout/policy/v1/ResetResponse.js";
import { ACTION_WIDTH, act, CAMERA, HORIZON, type Inputs } from "./wander.js";

const NAME = "wander";
const PROTOCOL_VERSION = 1;
/** Largest number of open episodes. Beyond it, the episode started first is removed. */
const MAX_SESSIONS = 1024;

interface Session {
  seed: string;
  /** The last query and its answer, which is repeated for a retry. */
  last?: { query: number; answer: InferResponse };
}

/** Reason for refusing a call. */
class Refusal extends Error {
  constructor(
    readonly code: status,
    message: string,
  ) {
    super(message);
  }
}

/** Implements the service's methods except InferBatch, to which the library
 * answers UNIMPLEMENTED: the description declares no batches. */
export function policy(): UntypedServiceImplementation {
  const sessions = new Map<string, Session>();
  return {
    Describe: answering((request: DescribeRequest__Output) => describe(request)),
    Reset: answering((request: ResetRequest__Output): ResetResponse => {
      requirePolicy(request.policy);
      sessions.delete(request.session);
      sessions.set(request.session, { seed: request.seed });
      for (const oldest of sessions.keys()) {
        if (sessions.size <= MAX_SESSIONS) break;
        sessions.delete(oldest);
      }
      return {};
    }),
    End: answering((request: EndRequest__Output): EndResponse => {
      requirePolicy(request.policy);
      sessions.delete(request.session);
      return {};
    }),
    Infer: answering((request: InferRequest__Output) => {
      requirePolicy(request.policy);
      return infer(request, sessions.get(request.session));
    }),
  };
}

function describe(request: DescribeRequest__Output): DescribeResponse {
  if (request.protocolVersion !== PROTOCOL_VERSION) {
    throw new Refusal(
      status.FAILED_PRECONDITION,
      `the caller speaks policy protocol version ${request.protocolVersion}, this server` +
        ` version ${PROTOCOL_VERSION}; upgrade the older side`,
    );
  }
  requirePolicy(request.policy);
  return {
    protocolVersion: PROTOCOL_VERSION,
    name: NAME,
    checkpoint: "example: no weights",
    cameras: [CAMERA],
    state: ["STATE_FIELD_EEF_POS"],
    horizon: HORIZON,
    execute: HORIZON,
    stochastic: true,
    language: "LANGUAGE_IGNORED",
    maxBatch: 1,
  };
}

function infer(request: InferRequest__Output, session: Session | undefined): InferResponse {
  const where = `session '${request.session}', query ${request.queryIndex}`;
  if (session === undefined) {
    throw new Refusal(
      status.UNAVAILABLE,
      `${where}: the session is not open here; start the rollout again`,
    );
  }
  if (session.last?.query === request.queryIndex) return session.last.answer;
  const actions = act(inputsOf(request, where), session.seed, request.queryIndex);
  const answer = { actions, actionWidth: ACTION_WIDTH };
  session.last = { query: request.queryIndex, answer };
  return answer;
}

function inputsOf(request: InferRequest__Output, where: string): Inputs {
  const image = request.observation?.images.find(({ camera }) => camera === CAMERA.name);
  const reading = request.observation?.state.find(({ field }) => field === "STATE_FIELD_EEF_POS");
  const bytes = CAMERA.width * CAMERA.height * 3;
  if (image?.rgb.length !== bytes || reading?.values.length !== 3) {
    throw new Refusal(
      status.INVALID_ARGUMENT,
      `${where}: unusable observation: a frame of ${CAMERA.name} in ${bytes} bytes and the` +
        " position of the fingertips are needed",
    );
  }
  return { rgb: image.rgb, position: reading.values };
}

/** Refuses a request for another policy, so that no worker measures the wrong one. */
function requirePolicy(name: string): void {
  if (name !== "" && name !== NAME) {
    throw new Refusal(
      status.NOT_FOUND,
      `this server serves no policy '${name}'; it serves ${NAME}`,
    );
  }
}

/** Returns a gRPC method that sends the result of `answer`, or its exception as a status. */
function answering<Request, Response>(answer: (request: Request) => Response) {
  return (call: ServerUnaryCall<Request, Response>, send: sendUnaryData<Response>): void => {
    try {
      send(null, answer(call.request));
    } catch (error) {
      const code = error instanceof Refusal ? error.code : status.INTERNAL;
      send({ code, details: error instanceof Error ? error.message : String(error) });
    }
  };
}
