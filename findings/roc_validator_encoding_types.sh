#!/usr/bin/env bash
# roc-validator 0.13.0: a file format is to be of the type "WebPage" or "Standard", and is warned about if it is.
#
# Guess: "WebPage" and "Standard" pass, alone and together; "Thing" is warned about.
# Seen: all four are warned about, with the words "Encoding format entities SHOULD include WebPage and/or Standard types",
#   in a crate that meets all requirements. Only a format without an entity of its own, such as "text/csv", has no warning.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile roc-validator==0.13.0 rocrate==0.16.0
cd "$folder"
"$folder/venv/bin/python" -W ignore - 2> /dev/null <<'END'
import importlib.resources
import json
import types
from pathlib import Path

from rocrate.rocrate import ROCrate
from rocrate_validator import models, services
from rocrate_validator.utils.http import HttpRequester

# the validator asks the network for the context of RO-Crates, of which rocrate brings a copy
text = importlib.resources.files("rocrate").joinpath("data", "ro-crate.jsonld").read_text()
kind = {"Content-Type": "application/ld+json"}
answer = types.SimpleNamespace(status_code=200, headers=kind, text=text, json=lambda: json.loads(text))
HttpRequester.get = lambda *_, **__: answer

TYPES = {"page": "WebPage", "standard": "Standard", "both": ["WebPage", "Standard"], "thing": "Thing", "none": None}
crate = ROCrate()
crate.name, crate.description, crate.license = "Tables", "Five tables.", "https://spdx.org/licenses/MIT"
for name, kind in TYPES.items():
    Path(f"{name}.csv").write_text("a\n1\n")
    formats = ["text/csv"]
    if kind is not None:
        crate.add_jsonld({"@id": f"https://example.org/{name}", "@type": kind, "name": name})
        formats.append({"@id": f"https://example.org/{name}"})
    crate.add_file(f"{name}.csv", properties={"name": name, "encodingFormat": formats})
crate.write("crate")

settings = services.ValidationSettings(
    rocrate_uri="crate", requirement_severity=models.Severity.RECOMMENDED, offline=True, cache_path="cache"
)
issues = services.validate(settings).get_issues()
required = [issue.message for issue in issues if issue.severity == models.Severity.REQUIRED]
found = [issue for issue in issues if issue.message.startswith("Encoding format entities SHOULD include WebPage")]
warned = {issue.violatingEntity.rpartition("/")[2] for issue in found}
for name, kind in TYPES.items():
    print(f"{name:10}{'warned about' if name in warned else 'passes'}")
print("required and missing:", required or "nothing")
raise SystemExit(0 if warned == set(TYPES) - {"none"} and not required else 1)
END
