"""Checks Kubernetes manifests against the API's schemas, and against each other.

`manifests.py FILE… [-- FILE…]…` prints a line of JSON for each group of files: the faults, each
container's command line and the number of resources."""

import json
import sys
from itertools import groupby
from pathlib import Path

import kubernetes_validate
import yaml

# The oldest version that large providers still serve, and the newest.
VERSIONS = ("1.31", kubernetes_validate.latest_version())
# Folder at which secrets are mounted.
SECRETS = "/etc/rollout/"


def matches(selector: dict, labels: dict) -> bool:
    return selector.items() <= labels.items()


def pod_template(document: dict) -> dict | None:
    return document.get("spec", {}).get("template")


class Manifests:
    def __init__(self, documents: list[dict]) -> None:
        self.documents = documents
        self.faults: list[str] = []

    def by_name(self, kind: str) -> dict[str, dict]:
        found = (document for document in self.documents if document["kind"] == kind)
        return {document["metadata"]["name"]: document for document in found}

    def add_fault(self, document: dict, fault: str) -> None:
        self.faults.append(f"{document['kind']} {document['metadata']['name']}: {fault}")

    def check_schemas(self) -> None:
        for document in self.documents:
            for version in VERSIONS:
                try:
                    kubernetes_validate.validate(document, version, strict=True)
                except (
                    kubernetes_validate.ValidationError,
                    kubernetes_validate.SchemaNotFoundError,
                ) as error:
                    self.add_fault(document, f"in {version}: {error}".splitlines()[0])

    def pods(self) -> list[tuple[dict, dict]]:
        pairs = [(document, pod_template(document)) for document in self.documents]
        return [(document, pod) for document, pod in pairs if pod]

    def check_references(self) -> None:
        for document, pod in self.pods():
            self.check_pod(document, pod["spec"])
            selector = document["spec"].get("selector")
            labels = pod["metadata"]["labels"]
            if selector and not matches(selector["matchLabels"], labels):
                self.add_fault(document, "its selector does not match its own pods")
        for kind in ("Service", "PodDisruptionBudget", "NetworkPolicy"):
            for document in self.by_name(kind).values():
                spec = document["spec"]
                selector = spec.get("podSelector", spec.get("selector"))
                self.select_pods(document, selector.get("matchLabels", selector))
        for policy in self.by_name("NetworkPolicy").values():
            self.check_policy(policy)
        for service in self.by_name("Service").values():
            pods = self.select_pods(service, service["spec"]["selector"])
            for port in service["spec"]["ports"]:
                self.check_port(service, pods, port["targetPort"])
        for scaled in self.by_name("ScaledObject").values():
            target = scaled["spec"]["scaleTargetRef"]["name"]
            if target not in self.by_name("Deployment"):
                self.add_fault(scaled, f"there is no Deployment {target}")

    def select_pods(self, document: dict, labels: dict) -> list[dict]:
        found = [pod for _, pod in self.pods() if matches(labels, pod["metadata"]["labels"])]
        if not found:
            self.add_fault(document, f"no pod has the labels {labels}")
        return [pod["spec"] for pod in found]

    def check_port(self, document: dict, pods: list[dict], name: object) -> None:
        for pod in pods:
            ports = [
                port["name"]
                for container in pod["containers"]
                for port in container.get("ports", [])
            ]
            if name not in ports:
                self.add_fault(document, f"no container has a port {name}")

    def check_policy(self, policy: dict) -> None:
        pods = self.select_pods(policy, policy["spec"]["podSelector"]["matchLabels"])
        for direction, peers in (("ingress", "from"), ("egress", "to")):
            for rule in policy["spec"].get(direction, []):
                peer_pods: list[dict] = []
                # A rule without peers admits every address.
                for peer in rule.get(peers, []):
                    if "podSelector" in peer:
                        peer_pods += self.select_pods(policy, peer["podSelector"]["matchLabels"])
                for port in rule["ports"]:
                    if isinstance(port["port"], str):
                        listening = pods if direction == "ingress" else peer_pods
                        self.check_port(policy, listening, port["port"])

    def check_pod(self, document: dict, pod: dict) -> None:
        if not pod["securityContext"].get("runAsNonRoot"):
            self.add_fault(document, "its pods may run as root")
        volumes = {volume["name"]: volume for volume in pod.get("volumes", [])}
        claims = document["spec"].get("volumeClaimTemplates", [])
        claimed = {claim["metadata"]["name"] for claim in claims}
        files: set[str] = set()
        for volume in volumes.values():
            if "secret" in volume:
                name = volume["secret"]["secretName"]
                files |= set(self.by_name("Secret").get(name, {}).get("stringData", {}))
                if name not in self.by_name("Secret"):
                    self.add_fault(document, f"there is no secret {name}")
            if "configMap" in volume and volume["configMap"]["name"] not in self.by_name(
                "ConfigMap"
            ):
                self.add_fault(document, f"there is no ConfigMap {volume['configMap']['name']}")
        for container in pod["containers"]:
            if not container["securityContext"].get("readOnlyRootFilesystem"):
                name = container["name"]
                self.add_fault(document, f"container {name} has a writable root file system")
            for mount in container.get("volumeMounts", []):
                if mount["name"] not in volumes.keys() | claimed:
                    self.add_fault(document, f"there is no volume {mount['name']}")
            for argument in container["args"]:
                value = argument.partition("=")[2]
                if value.startswith(SECRETS) and value.removeprefix(SECRETS) not in files:
                    self.add_fault(document, f"no secret has {value.removeprefix(SECRETS)}")
                if value.startswith("https://"):
                    self.check_address(document, value.removeprefix("https://"))

    def check_address(self, document: dict, address: str) -> None:
        host, _, port = address.partition(":")
        service = self.by_name("Service").get(host)
        ports = [str(entry["port"]) for entry in service["spec"]["ports"]] if service else []
        if port not in ports:
            self.add_fault(document, f"no service listens on {address}")


def check(paths: list[str]) -> dict:
    documents = []
    for path in paths:
        loaded = yaml.safe_load_all(Path(path).read_text())
        documents += [document for document in loaded if document]
    manifests = Manifests(documents)
    manifests.check_schemas()
    manifests.check_references()
    containers = [
        container for _, pod in manifests.pods() for container in pod["spec"]["containers"]
    ]
    return {
        "faults": manifests.faults,
        "commands": [container["command"] + container["args"] for container in containers],
        "resources": len(documents),
    }


if __name__ == "__main__":
    for is_separator, paths in groupby(sys.argv[1:], "--".__eq__):
        if not is_separator:
            print(json.dumps(check(list(paths))))
