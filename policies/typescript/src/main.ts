/**
 * Serves the policy: `node dist/src/main.js [ADDR]`, by default on a free port
 * of the loopback. Prints one line, `listening on HOST:PORT`; stops on SIGTERM or SIGINT.
 */

import { fileURLToPath } from "node:url";

import { loadPackageDefinition, Server, ServerCredentials } from "@grpc/grpc-js";
import { loadSync } from "@grpc/proto-loader";
import { HealthImplementation } from "grpc-health-check";

import type { ProtoGrpcType } from "../generated/policy.js";
import { policy } from "./service.js";

const SERVICE = "rollout.policy.v1.Policy";
/** Largest message, bytes: as in the gateway and the worker. */
const MAX_MESSAGE_BYTES = 32 << 20;

const definition = loadSync("rollout/policy/v1/policy.proto", {
  includeDirs: [fileURLToPath(new URL("../../../../proto", import.meta.url))],
  longs: String,
  enums: String,
  defaults: true,
  oneofs: true,
});
const { rollout } = loadPackageDefinition(definition) as unknown as ProtoGrpcType;

const server = new Server({ "grpc.max_receive_message_length": MAX_MESSAGE_BYTES });
server.addService(rollout.policy.v1.Policy.service, policy());
new HealthImplementation({ "": "SERVING", [SERVICE]: "SERVING" }).addToServer(server);

const listen = process.argv[2] ?? "127.0.0.1:0";
server.bindAsync(listen, ServerCredentials.createInsecure(), (error, port) => {
  if (error) {
    console.error(`error: failed to listen on ${listen}: ${error.message}`);
    process.exit(1);
  }
  console.log(`listening on ${listen.slice(0, listen.lastIndexOf(":"))}:${port}`);
});
for (const signal of ["SIGTERM", "SIGINT"] as const) {
  process.on(signal, () => server.tryShutdown(() => process.exit(0)));
}
