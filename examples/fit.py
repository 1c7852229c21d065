"""A fit query from Python, made from the published .proto files alone.

    pip install grpcio-tools
    python -m grpc_tools.protoc -I proto/proto --python_out=. --grpc_python_out=. \\
        farm/v1/model.proto farm/v1/fits.proto
    python examples/fit.py access/client.toml paper examples/white.csv
"""

import csv
import sys
import tomllib

import grpc
from farm.v1 import fits_pb2, fits_pb2_grpc, model_pb2

access_file, dictionary, measurement = sys.argv[1:]
access = tomllib.load(open(access_file, "rb"))
secure = grpc.composite_channel_credentials(
    grpc.ssl_channel_credentials(access["ca_certificate"].encode()),
    grpc.access_token_call_credentials(access["token"]),
)
channel = grpc.secure_channel(access["server"].removeprefix("https://"), secure)

profiles = {}
for row in csv.DictReader(line for line in open(measurement) if not line.startswith("#")):
    key = row["channel"], float(row["thickness_mm"])
    profile = profiles.setdefault(key, model_pb2.MeasuredProfile(channel=key[0], thickness_mm=key[1]))
    profile.x_mm.append(float(row["x_mm"]))
    profile.values.append(float(row["value"]))

request = fits_pb2.FitRequest(
    dictionary=dictionary,
    measurement=model_pb2.Measurement(material="white", profiles=profiles.values()),
    options=fits_pb2.FitOptions(g=fits_pb2.Bounds(min=0.4, max=0.4), refine=True),
)
answer = fits_pb2_grpc.FitsStub(channel).Fit(request, timeout=30)
for fitted in answer.fit.channels:
    medium = fitted.refined.best.medium
    print(f"{fitted.channel}: sigma_t {medium.sigma_t_per_mm:.3g} /mm, albedo {medium.albedo:.6f}")
