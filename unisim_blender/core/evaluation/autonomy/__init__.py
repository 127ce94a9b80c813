"""Metrics of autonomy on sensor data: detections, forecasts and plans, compared with labels or with those on other
data.

numpy alone, and files of JSON in: usable on anybody's outputs. The metrics are the paper's (Yang et al., CVPR 2023,
supplementary 3.3, 4.4 and 4.5).
"""
