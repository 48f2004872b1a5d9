"""Results as JSON objects, fields and units as the contract has them (SI; schema 1)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from gyrowheel.show.sentences.correction import map_sentences
from gyrowheel.show.sentences.diagnosis import evidence, several, verdict_sentence
from gyrowheel.show.sentences.findings import (
    event_sentence,
    instrument_sentence,
    law_sentence,
    reading_sentence,
    shape_sentence,
)
from gyrowheel.show.sentences.proof import calibration_notes, proof_sentence
from gyrowheel.show.sentences.residuals import dependence_sentences, region_description, region_name
from gyrowheel.show.sentences.setup import cure_of, map_lines, misstated_sentence, problem
from gyrowheel_analysis.channels import LISTED, TORQUES
from gyrowheel_analysis.residuals.maps import maps_json
from gyrowheel_sim.effects.torque_map import map_to_mapping

if TYPE_CHECKING:
    from gyrowheel_analysis.calibrate import Calibration
    from gyrowheel_analysis.compare import Comparison
    from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap
    from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent
    from gyrowheel_analysis.diagnosis.estimates import Estimate, Misstated
    from gyrowheel_analysis.diagnosis.findings import EffectFinding, InstrumentFinding, TieReport
    from gyrowheel_analysis.diagnosis.proof_result import Proof
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding
    from gyrowheel_analysis.residuals.error_table import ErrorTable
    from gyrowheel_analysis.residuals.maps import Region
    from gyrowheel_recording.mislabelled import WrongSetup


def comparison_json(found: Comparison) -> dict[str, Any]:
    """Return a comparison as a JSON object."""
    raw = {name: found.raw_rms[name] for name in TORQUES if name in found.raw_rms}
    many = len({*found.recordings, *(event.recording for event in found.events)}) > 1
    return {
        "schema": 1,
        "error": {"unit": "N·m", "before": found.error_before.to_json(), "raw": {"rms": raw}},
        "channels": {
            name: {"unit": LISTED[name].unit, **asdict(metrics), "raw_rms": found.raw_rms[name]}
            for name, metrics in found.channels.items()
        },
        "where": [_region(region) for region in found.where],
        "dependence": dependence_sentences(found.dependence),
        "tests": [test.to_json() for test in found.tests],
        "whiteness": [test.to_json() for test in found.whiteness],
        "maps": maps_json(found.maps),
        "misstated": misstated_json(found.misstated, found.model),
        "instruments": reading_json(found.readings),
        "events": [event_json(event, several=many) for event in found.events],
        "recordings": list(found.recordings),
        "model": found.model,
        "assumed": list(found.coverage.assumed),
        "coverage": found.coverage.to_json(),
    }


def reading_json(found: Sequence[ReadingFinding]) -> list[dict[str, Any]]:
    """Return deviations of the instruments that the samples show as JSON objects."""
    return [
        {**asdict(item), "shown_by": "samples", "sentence": reading_sentence(item), "ties": []}
        for item in found
    ]


def setup_json(found: Sequence[WrongSetup]) -> list[dict[str, Any]]:
    """Return wrong setups as JSON objects, each with the corrections of its recording."""
    return [
        {"problem": problem(item), "cure": cure_of(item, found), "map": map_lines(item), **item.to_json()}
        for item in found
    ]


def misstated_json(found: Sequence[Misstated], model: str) -> list[dict[str, Any]]:
    """Return bench parameters that a model file has far from their values as JSON objects."""
    return [{**asdict(item), "sentence": misstated_sentence(item, model)} for item in found]


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as a JSON object."""
    test, many = found.next_test, several(found)
    return {
        "schema": 1,
        "verdict": found.verdict,
        "summary": verdict_sentence(found),
        "effects": [_effect(finding) for finding in found.effects],
        "free_form": [
            {
                **_picked(form, "name formula delta_chi2"),
                "coefficients": _coefficients(form.coefficients),
                "declaration": form.declaration,
                "simple": form.simple or None,
                "ties": _ties(form.ties),
            }
            for form in found.free_form
        ],
        "rejected": list(found.rejected),
        "map": None if found.map is None else map_json(found.map),
        "events": [event_json(event, several=many) for event in found.events],
        "turned": [event_json(event, several=many) for event in found.turned],
        "laws": [{**asdict(law), "sentence": law_sentence(law, several=many)} for law in found.laws],
        "drift": dict(found.drift_scales),
        "drift_shapes": [
            {**asdict(shape), "sentence": shape_sentence(shape, several=many)} for shape in found.drift_shapes
        ],
        "error": None if found.error is None else found.error.to_json(),
        "where": [_region(region) for region in found.where],
        "next_test": None if test is None else _picked(test, "plan expected_separation minutes"),
        "proof": proof_json(found.proof, found.error),
        "ended": found.ended,
        "beyond": [
            {key: value if value != math.inf else None for key, value in asdict(item).items()}
            for item in found.beyond
        ],
        "nuisance": {
            name: _picked(n, "value standard_error prior_value prior_uncertainty")
            for name, n in found.nuisance.items()
        },
        "instruments": [*map(_instrument, found.instruments), *reading_json(found.readings)],
        "detection_limits": [
            {
                **_picked(limit, "effect coefficient"),
                "value": limit.value if math.isfinite(limit.value) else None,
                **_picked(limit, "unit visible"),
            }
            for limit in found.limits
        ],
        "setup": setup_json(found.setup),
        "misstated": misstated_json(found.misstated, found.model),
        "recordings": list(found.recordings),
        "model": found.model,
        "assumed": list(found.coverage.assumed),
        "coverage": found.coverage.to_json(),
        "versions": found.versions,
    }


def map_json(found: CorrectionMap) -> dict[str, Any]:
    """Return a correction map as a JSON object."""
    return {
        "name": found.effect.name,
        **map_to_mapping(found.effect),
        "coefficients": {
            name: {"value": value, "standard_error": found.errors[name], "unit": "N*m"}
            for name, value in found.values.items()
        },
        "effects": {name: dict(values) for name, values in found.effects.items()},
        **_picked(found, "gain orthogonal nearest nearest_share"),
        "dependence": [asdict(item) for item in found.dependence],
        "leading": [asdict(item) | {"powers": list(item.powers)} for item in found.leading],
        "error": found.error.to_json(),
        "sentences": map_sentences(found),
    }


def proof_json(proof: Proof | None, table: ErrorTable | None) -> dict[str, Any] | None:
    """Return a proof as a JSON object; its reason is a sentence, its cause a word."""
    if proof is None:
        return None
    own = asdict(proof)
    own["causes"] = list(proof.causes)
    return {
        "recording": own.pop("recording"),
        "proven": own.pop("proven"),
        "reason": proof_sentence(proof, table),
        "kind": own.pop("reason"),
        **own,
    }


def calibration_json(found: Calibration) -> dict[str, Any]:
    """Return a calibration as a JSON object."""
    return {
        "schema": 1,
        "constants": {
            c.name: {
                "unit": c.unit,
                "stated": {"value": c.stated.value, "uncertainty": c.stated.standard_error},
                "before": _picked(c.before, "value standard_error"),
                "after": _picked(c.after, "value standard_error"),
                "limited_by": c.limited_by or None,
            }
            for c in found.constants.values()
        },
        "undetermined": dict(found.undetermined),
        "chi2_per_n": found.chi2_per_n,
        "notes": calibration_notes(found),
        "recordings": list(found.recordings),
    }


def event_json(event: DatedEvent, *, several: bool) -> dict[str, Any]:
    """Return an event as a JSON object; `several` as in `event_sentence`."""
    return {
        "time": event.time,
        "time_standard_error": event.time_error,
        "end": event.end,
        "end_standard_error": event.end_error,
        **_picked(event, "kind channel size standard_error unit recording gain"),
        "ties": list(event.ties),
        "still_in": list(event.still_in),
        "sentence": event_sentence(event, several=several),
    }


def _effect(finding: EffectFinding) -> dict[str, Any]:
    return {
        "name": finding.name,
        "coefficients": _coefficients(finding.coefficients),
        **_picked(finding, "delta_chi2 formula"),
        "evidence": evidence(finding),
        "in_model": None if finding.in_model is None else _coefficients(finding.in_model),
        "ties": _ties(finding.ties),
    }


def _instrument(finding: InstrumentFinding) -> dict[str, Any]:
    return {
        **_picked(finding, "name channel quantity value standard_error stated unit delta_chi2"),
        "shown_by": "torques",
        "sentence": instrument_sentence(finding),
        "ties": _ties(finding.ties),
    }


def _ties(ties: Sequence[TieReport]) -> list[dict[str, Any]]:
    return [
        _picked(tie, "name delta_chi2 separating_plan expected_separation")
        | ({} if tie.form is None else {"formula": tie.form.formula})
        for tie in ties
    ]


def _region(region: Region) -> dict[str, Any]:
    return {
        "region": region_name(region),
        "share_of_chi2": region.share_of_chi2,
        "description": region_description(region),
    }


def _coefficients(values: Mapping[str, Estimate]) -> dict[str, Any]:
    return {
        name: _picked(e, "value standard_error unit") | _parts(e) | _prior(e) for name, e in values.items()
    }


def _parts(e: Estimate) -> dict[str, Any]:
    """Return the parts of the standard error, and the 95 % interval from all uncertainties."""
    if e.parts is None:
        return {}
    return {
        "parts": _picked(e.parts, "noise bench undetected"),
        "interval": list(e.parts.interval),
    }


def _prior(e: Estimate) -> dict[str, Any]:
    """Return the prior of a coefficient that has one, and what the data alone give."""
    if e.prior is None:
        return {}
    data = None if e.data is None else {"value": e.data[0], "standard_error": e.data[1]}
    prior = {"mean": e.prior.mean, "standard_deviation": e.prior.deviation, "source": e.source}
    return {"prior": prior, "data": data}


def _picked(item: object, names: str) -> dict[str, Any]:
    """Return some members of a result by their names, in this order."""
    return {name: getattr(item, name) for name in names.split()}
