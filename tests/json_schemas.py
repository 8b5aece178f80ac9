"""The schemas of the package, and documents checked against them down to the last field."""

import copy
import json
from importlib.resources import files

from jsonschema import Draft202012Validator

SCHEMAS = {
    path.name.removesuffix(".schema.json"): json.loads(path.read_text(encoding="utf-8"))
    for path in (files("pgti_gtsam") / "report" / "schemas").iterdir()
}


def closed(schema):
    """The schema without room for fields that it does not name."""
    schema = copy.deepcopy(schema)

    def close(part):
        if isinstance(part, dict):
            if "properties" in part:
                part["additionalProperties"] = False
            for each in part.values():
                close(each)
        elif isinstance(part, list):
            for each in part:
                close(each)

    close(schema)
    return schema


def check(name, document):
    errors = [
        f"{error.json_path}: {error.message}"
        for error in Draft202012Validator(closed(SCHEMAS[name])).iter_errors(document)
    ]
    assert errors == []
