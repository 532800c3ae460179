"""The speed of grasp planning's parts: rows, ratios, table."""

from agents import gpis_speed, grasp_speed, ray_speed, speed_grasp
from agents.speed_grasp import Cost, costs, table


def test_rows_stand_beside_what_they_are_compared_with(monkeypatch):
    seconds = {name: 2.0 for name in speed_grasp.BARE} | {bare: 1.0 for bare, _ in speed_grasp.BARE.values()}
    monkeypatch.setattr(gpis_speed, "measure", lambda repeats: seconds)
    rows = [grasp_speed.Row("a closure / every hull", 0.1, 3.0, 30.0, 20.0), grasp_speed.Row("b / c", 1.0, 2.0, 2.0, 0)]
    monkeypatch.setattr(grasp_speed, "measure", lambda repeats: rows)
    monkeypatch.setattr(ray_speed, "measure", lambda repeats: [ray_speed.Row("rays", 1.2, 1.0, 1.2, 0, 3)])
    found = {row.name: row for row in costs(1)}
    assert found["implicit surface, fit"].ratio == 2.0 and found["implicit surface, fit"].wanted == 1.5
    assert found["a closure"] == Cost("a closure", 0.1, "every hull", 3.0, 0.05)
    assert found["b"].wanted == 0.0 and found["rays"].other == "Embree"
    text = table(list(found.values()))
    assert "every hull" in text and "≤ 0.05" in text
