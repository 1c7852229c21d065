"""Requests a fit from Python, with only the published .proto files.

    python3 -m venv venv && . venv/bin/activate
    pip install grpcio-tools
    python -m grpc_tools.protoc -I proto/proto --python_out=examples --grpc_python_out=examples \\
        farm/v1/model.proto farm/v1/fits.proto
    python examples/fit.py access/client.toml paper examples/white.csv

The first argument is an access file or, for a coordinator without one, its URL, as in http://127.0.0.1:7700.
"""

import csv
import os
import pathlib
import sys
import tomllib

import grpc

try:
    from farm.v1 import fits_pb2, fits_pb2_grpc, model_pb2
except ModuleNotFoundError as error:
    sys.exit(f"{error}: make the modules first, next to this file, as described at its head")


def connect(farm):
    """A channel to the coordinator of an access file, or to the one at a URL that begins with http://."""
    if farm.startswith("http://"):
        address = farm.removeprefix("http://").rstrip("/")
        direct = [("grpc.enable_http_proxy", 0)]
        # A coordinator without an access file has a socket here, which only its user's programs can reach.
        for folder in (f"/run/user/{os.geteuid()}/resin-farm", f"/tmp/resin-farm-{os.geteuid()}"):
            if (socket := pathlib.Path(folder, address.rpartition(":")[2])).is_socket():
                # HTTP/2 requires the name of a host, which a path is not.
                return grpc.insecure_channel(f"unix:{socket}", [*direct, ("grpc.default_authority", "localhost")])
        return grpc.insecure_channel(address, direct)
    if farm.startswith("https://"):
        sys.exit(f"{farm}: an access file is needed, which holds the certificate to know the coordinator by")
    with open(farm, "rb") as file:
        access = tomllib.load(file)
    # The key and certificate are present only if the coordinator requires them.
    keys = [access[name].encode() if name in access else None for name in ("ca_certificate", "key", "certificate")]
    secure = grpc.composite_channel_credentials(
        grpc.ssl_channel_credentials(*keys), grpc.access_token_call_credentials(access["token"])
    )
    name = access.get("server_name")
    options = [("grpc.ssl_target_name_override", name)] if name else []
    return grpc.secure_channel(access["server"].removeprefix("https://").rstrip("/"), secure, options)


def read(path):
    """The profiles of a file, by material, channel and thickness."""
    materials = {}
    with open(path, encoding="utf-8") as file:
        for row in csv.DictReader(line for line in file if not line.startswith("#")):
            profiles = materials.setdefault(row["material"], {})
            channel, thickness_mm = row["channel"], float(row["thickness_mm"])
            empty = model_pb2.MeasuredProfile(channel=channel, thickness_mm=thickness_mm)
            profile = profiles.setdefault((channel, thickness_mm), empty)
            profile.x_mm.append(float(row["x_mm"]))
            profile.values.append(float(row["value"]))
            if row.get("std_error"):
                profile.std_errors.append(float(row["std_error"]))
    return materials


def main():
    if len(sys.argv) != 4:
        sys.exit("usage: fit.py ACCESS_FILE|URL DICTIONARY MEASUREMENT.csv")
    farm, dictionary, measurement = sys.argv[1:]
    fits = fits_pb2_grpc.FitsStub(connect(farm))
    options = fits_pb2.FitOptions(g=fits_pb2.Bounds(min=0.4, max=0.4), refine=True)
    for material, profiles in read(measurement).items():
        measured = model_pb2.Measurement(material=material, profiles=profiles.values())
        request = fits_pb2.FitRequest(dictionary=dictionary, measurement=measured, options=options)
        try:
            answer = fits.Fit(request, timeout=30)
        except grpc.RpcError as error:
            sys.exit(f"{error.code().name}: {error.details()}")
        for fitted in answer.fit.channels:
            medium = fitted.refined.best.medium
            print(f"{fitted.channel}: sigma_t {medium.sigma_t_per_mm:.3g} /mm, albedo {medium.albedo:.6f}")


if __name__ == "__main__":
    main()
