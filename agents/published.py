"""Figures that the thesis publishes, for comparison."""

# Table 5.3: (mean error, standard deviation), each per axis x, y, z [m], measured with a total station
TABLE_5_3 = {
    "gps": ((0.164, 0.153, 0.179), (0.079, 0.123, 0.085)),
    "vision": ((0.022, 0.012, 0.023), (0.027, 0.032, 0.026)),
    "dock": ((0.034, 0.036, 0.040), (0.032, 0.028, 0.039)),
}
TABLE_5_3_RATES = {"gps": 10, "vision": 25, "dock": 1200}  # [Hz]

# Table 3.3, on its own photographs of four hand tools: (mAP@0.5, mAP@0.75, recall); for YOLO v3 the text gives
# an average mAP and the recall
TABLE_3_3: dict[str, tuple[float, float | None, float]] = {
    "SSD-MobileNet": (0.6923, 0.4670, 0.5945),
    "YOLO v3": (0.77, None, 0.70),
}
TABLE_3_4_SECONDS = 0.053  # [s] a picture on the embedded computer, the fastest of Table 3.4
