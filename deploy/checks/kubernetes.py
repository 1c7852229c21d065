"""Checks rules of rendered Kubernetes objects that are not in their schemas.

usage: kubernetes.py RENDERED
"""

import sys
from pathlib import Path

import yaml
from durations import enough_to_stop

NAMESPACE = "resin-farm"


class Objects:
    def __init__(self, documents):
        self.all = [document for document in documents if document]

    def of(self, *kinds):
        return [document for document in self.all if document["kind"] in kinds]

    def named(self, kind, name):
        return next((document for document in self.of(kind) if document["metadata"]["name"] == name), None)

    def workloads(self):
        return self.of("StatefulSet", "Deployment")

    def pods_with(self, labels):
        """Templates of pods that a selector matches."""
        templates = (workload["spec"]["template"] for workload in self.workloads())
        return [template for template in templates if labels.items() <= template["metadata"]["labels"].items()]


def name_of(document):
    return f"{document['kind']} {document['metadata']['name']}"


def problems(objects):
    for document in objects.all:
        if document["kind"] != "Namespace" and document["metadata"].get("namespace") != NAMESPACE:
            yield f"{name_of(document)}: must be in the namespace {NAMESPACE}"
    for workload in objects.workloads():
        yield from workload_problems(objects, workload)
    for service in objects.of("Service"):
        yield from service_problems(objects, service)
    for budget in objects.of("PodDisruptionBudget"):
        if not objects.pods_with(budget["spec"]["selector"]["matchLabels"]):
            yield f"{name_of(budget)}: its selector finds no pod"
    for claimed in objects.of("StatefulSet"):
        headless = objects.named("Service", claimed["spec"]["serviceName"])
        if not headless or headless["spec"].get("clusterIP") != "None":
            yield f"{name_of(claimed)}: serviceName must be a headless service"
        if claimed["spec"]["replicas"] != 1:
            yield f"{name_of(claimed)}: there must be one coordinator"
    for scaled in objects.of("ScaledObject"):
        yield from scaling_problems(objects, scaled)
    yield from policy_problems(objects)


def scaling_problems(objects, scaled):
    target = scaled["spec"]["scaleTargetRef"]
    workload = objects.named(target.get("kind", "Deployment"), target["name"])
    if workload is None:
        yield f"{name_of(scaled)}: there is no {target.get('kind', 'Deployment')} {target['name']}"
    elif "replicas" in workload["spec"]:
        yield f"{name_of(workload)}: sets replicas, which each apply would set back"


def workload_problems(objects, workload):
    name, spec = name_of(workload), workload["spec"]
    template = spec["template"]
    if not spec["selector"]["matchLabels"].items() <= template["metadata"]["labels"].items():
        yield f"{name}: its selector does not find its own pods"
    pod = template["spec"]
    if pod.get("automountServiceAccountToken") is not False:
        yield f"{name}: automountServiceAccountToken must be false"
    if any(pod.get(key) for key in ("hostNetwork", "hostPID", "hostIPC")):
        yield f"{name}: must not share a namespace with the node"
    context = pod["securityContext"]
    if not context.get("runAsNonRoot") or context.get("seccompProfile", {}).get("type") != "RuntimeDefault":
        yield f"{name}: must run as another user than root, with the runtime's seccomp profile"
    for container in pod["containers"]:
        yield from container_problems(name, container)
        given_s = pod.get("terminationGracePeriodSeconds", 30)
        yield from enough_to_stop(name, container["command"], given_s)
        yield from mount_problems(name, workload, container)
    for volume in pod.get("volumes", []):
        if "hostPath" in volume:
            yield f"{name}: volume {volume['name']} is a folder of the node"
        if "secret" in volume:
            yield from secret_problems(objects, name, volume, context)


def container_problems(name, container):
    context = container.get("securityContext", {})
    if context.get("privileged") or context.get("allowPrivilegeEscalation") is not False:
        yield f"{name}: must not be privileged, nor become it"
    if not context.get("readOnlyRootFilesystem") or context.get("capabilities", {}) != {"drop": ["ALL"]}:
        yield f"{name}: needs a read-only root and no capabilities"
    if "memory" not in container.get("resources", {}).get("limits", {}):
        yield f"{name}: has no limit of memory"
    ports = {port["name"]: port["containerPort"] for port in container.get("ports", [])}
    for port, number in ports.items():
        if not any(word.endswith(f":{number}") for word in container["command"]):
            yield f"{name}: nothing listens on the port {port}"
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        port = container.get(probe, {}).get("httpGet", {}).get("port")
        if port is not None and port not in ports and port not in ports.values():
            yield f"{name}: {probe} asks at {port}, which is no port of the container"


def mount_problems(name, workload, container):
    volumes = {volume["name"]: volume for volume in workload["spec"]["template"]["spec"].get("volumes", [])}
    claims = {claim["metadata"]["name"] for claim in workload["spec"].get("volumeClaimTemplates", [])}
    mounts = container.get("volumeMounts", [])
    for mount in mounts:
        if mount["name"] not in volumes.keys() | claims:
            yield f"{name}: there is no volume {mount['name']}"
        if "secret" in volumes.get(mount["name"], {}) and not mount.get("readOnly"):
            yield f"{name}: the secret {mount['name']} must be mounted read-only"
    folders = [mount["mountPath"] for mount in mounts]
    for word in container["command"]:
        option, _, path = word.partition("=")
        if option in ("--data", "--access") and not any((path + "/").startswith(f + "/") for f in folders):
            yield f"{name}: {word}: nothing is mounted there"


def secret_problems(objects, name, volume, context):
    secret = objects.named("Secret", volume["secret"]["secretName"])
    if secret is None:
        yield f"{name}: there is no secret {volume['secret']['secretName']}"
    elif "access.toml" not in secret["data"]:
        yield f"{name}: the secret {volume['secret']['secretName']} has no access.toml"
    if volume["secret"].get("defaultMode") != 0o440 or not context.get("fsGroup"):
        yield f"{name}: volume {volume['name']} needs mode 0440 and an fsGroup: the programs refuse open files"


def service_problems(objects, service):
    name = name_of(service)
    pods = objects.pods_with(service["spec"]["selector"])
    if not pods:
        yield f"{name}: its selector finds no pod"
    for pod in pods:
        ports = [port for container in pod["spec"]["containers"] for port in container.get("ports", [])]
        known = {port["name"] for port in ports} | {port["containerPort"] for port in ports}
        for port in service["spec"]["ports"]:
            if port.get("targetPort", port["port"]) not in known:
                yield f"{name}: port {port['port']} goes to {port.get('targetPort')}, which its pods do not have"


def policy_problems(objects):
    """Checks that everything is denied by default, and that the connection of workers is allowed on both sides."""
    policies = objects.of("NetworkPolicy")
    denied = [p for p in policies if not p["spec"]["podSelector"] and not p["spec"].keys() & {"ingress", "egress"}]
    if not any(sorted(policy["spec"]["policyTypes"]) == ["Egress", "Ingress"] for policy in denied):
        yield "no NetworkPolicy denies everything by default"
    for policy in policies:
        selector = policy["spec"]["podSelector"].get("matchLabels")
        if selector and not objects.pods_with(selector):
            yield f"{name_of(policy)}: its selector finds no pod"
    coordinator = {"app.kubernetes.io/name": "farm-coordinator"}
    worker = {"app.kubernetes.io/name": "farm-worker"}
    for side, here, there in (("ingress", coordinator, worker), ("egress", worker, coordinator)):
        if not any(allows(policy, side, here, there, 7700) for policy in policies):
            yield f"no NetworkPolicy allows {side} between workers and coordinator on port 7700"


def allows(policy, side, here, there, port):
    if policy["spec"]["podSelector"].get("matchLabels") != here:
        return False
    peers = {"ingress": "from", "egress": "to"}[side]
    return any(
        any(peer.get("podSelector", {}).get("matchLabels") == there for peer in rule.get(peers, []))
        and any(entry["port"] == port for entry in rule["ports"])
        for rule in policy["spec"].get(side, [])
    )


def main():
    objects = Objects(yaml.safe_load_all(Path(sys.argv[1]).read_text()))
    wrong = list(problems(objects))
    print("\n".join(wrong) or f"  {len(objects.all)} objects are hardened and fit together")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
