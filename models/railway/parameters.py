"""Parameters of the car, of the bogie and of the bogie under test (Tables 1, 3 and 5 of the case study).

Source: D. Ribeiro, R. Calcada, R. Delgado, M. Brehm, V. Zabel, "Model calibration of a railway vehicle", RDO-Journal 02
(the case study of the same authors' Vehicle System Dynamics 51(6), 2013, 821-856). Limits not printed there follow from
mean and standard deviation of a uniform distribution where those are printed; everything else is marked assumed.
"""

from __future__ import annotations

from calib import Parameter

_TABLE_1 = "Ribeiro et al., case study, Table 1"
_TABLE_3 = "Ribeiro et al., case study, Table 3"
_TABLE_5 = "Ribeiro et al., case study, Table 5"

CAR: tuple[Parameter, ...] = (
    Parameter(
        "K_secondary_front", 256.4, 242.0, 270.8, "kN/m",
        description="vertical stiffness of one secondary spring of the front bogie", symbol="KS1", source=_TABLE_1,
        assumed="nominal value (printed mean taken)",
    ),
    Parameter(
        "K_secondary_rear", 256.4, 242.0, 270.8, "kN/m",
        description="vertical stiffness of one secondary spring of the rear bogie", symbol="KS2", source=_TABLE_1,
        assumed="nominal value (printed mean taken)",
    ),
    Parameter(
        "c_secondary", 35.0, 28.0, 42.0, "kNs/m",
        description="one secondary damper", symbol="cS", source=_TABLE_1,
        assumed="nominal value (printed mean taken) and limits (mean -/+ 20 %)",
    ),
    Parameter(
        "c_yaw", 400.0, 320.0, 480.0, "kNs/m",
        description="one yaw damper", symbol="cAL", source=_TABLE_1,
        assumed="nominal value (printed mean taken) and limits (mean -/+ 20 %)",
    ),
    Parameter(
        "K_rod_tilting", 20_000.0, 5_000.0, 35_000.0, "kN/m",
        description="connecting rod between tilting and load bolster", symbol="Kb", source=_TABLE_1,
    ),
    Parameter(
        "rho_aluminium", 2700.0, 2600.0, 2800.0, "kg/m3", distribution="fixed",
        description="density of the car body", symbol="rho_alu", source=_TABLE_1,
        assumed="limits (deterministic in the source)",
    ),
    Parameter(
        "E_aluminium", 70.0, 65.0, 75.0, "GPa", distribution="fixed",
        description="Young's modulus of the car body", symbol="E_alu", source=_TABLE_1,
        assumed="limits (deterministic in the source)",
    ),
    Parameter(
        "RMI_base", 225.0, 50.0, 400.0,
        description="ratio of moments of inertia of the base: real panel over equivalent sheet", symbol="RMIb",
        source=_TABLE_1, assumed="nominal value (printed mean taken)",
    ),
    Parameter(
        "RMI_walls", 90.0, 20.0, 160.0,
        description="ratio of moments of inertia of side and end walls", symbol="RMIp", source=_TABLE_1,
        assumed="nominal value (printed mean taken) and limits",
    ),
    Parameter(
        "RMI_cover", 300.0, 100.0, 500.0,
        description="ratio of moments of inertia of the cover", symbol="RMIc", source=_TABLE_1,
        assumed="nominal value (printed mean taken) and limits",
    ),
    Parameter(
        "m_base", 70.0, 50.0, 90.0, "%",
        description="share of the further equipment's 12 t that is spread over the base", symbol="Mb", source=_TABLE_1,
        assumed="the 12 t (lost)",
    ),
    Parameter(
        "m_walls", 20.0, 5.0, 35.0, "%",
        description="share of the further equipment's 12 t that is spread over the side walls", symbol="Mp",
        source=_TABLE_1, assumed="the 12 t (lost)",
    ),
    Parameter(
        "m_cover", 10.0, 0.0, 15.0, "%",
        description="share of the further equipment's 12 t that is spread over the cover", symbol="Mc", source=_TABLE_1,
        assumed="the 12 t (lost)",
    ),
    Parameter(
        "t_base", 10.2, 9.2, 11.2, "mm", distribution="fixed",
        description="equivalent thickness of the base", symbol="e_bas", source=_TABLE_1,
        assumed="limits (deterministic in the source)",
    ),
    Parameter(
        "t_walls", 10.3, 9.3, 11.3, "mm", distribution="fixed",
        description="equivalent thickness of side and end walls", symbol="e_par", source=_TABLE_1,
        assumed="limits (deterministic in the source)",
    ),
    Parameter(
        "t_cover", 8.8, 7.9, 9.7, "mm", distribution="fixed",
        description="equivalent thickness of the cover", symbol="e_cob", source=_TABLE_1,
        assumed="limits (deterministic in the source)",
    ),
)  # fmt: skip
"""Table 1."""

OTHERS = 12_000.0
"""Mass in kg of the further equipment, which `m_base`, `m_walls` and `m_cover` share; assumed."""

BOGIE: tuple[Parameter, ...] = (
    Parameter(
        "K_primary", 564.0, 451.0, 677.0, "kN/m",
        description="vertical stiffness of one primary spring", symbol="KP", source=_TABLE_3,
        assumed="nominal value (printed mean taken) and limits (mean -/+ 20 %)",
    ),
    Parameter(
        "c_primary", 18.0, 14.4, 21.6, "kNs/m",
        description="one primary damper", symbol="cP", source=_TABLE_3,
        assumed="nominal value (printed mean taken) and limits (mean -/+ 20 %)",
    ),
    Parameter(
        "K_rod_upper", 6.5, 5.0, 8.0, "MN/m",
        description="upper connecting rod of the axle box", symbol="Kbls", source=_TABLE_3,
        assumed="nominal value (printed mean taken) and limits",
    ),
    Parameter(
        "K_rod_lower", 25.0, 20.0, 30.0, "MN/m",
        description="lower connecting rod of the axle box", symbol="Kbli", source=_TABLE_3,
    ),
    Parameter(
        "K_rail", 1200.0, 1000.0, 1600.0, "MN/m", distribution="fixed",
        description="wheel-rail contact, vertical", symbol="Krc", source=_TABLE_3,
        assumed="value and limits (linearised Hertz contact is typically 1000-1600 MN/m)",
    ),
    Parameter(
        "m_girder_centre", 75.0, 0.0, 150.0, "kg/m",
        description="additional mass of the girders between the crossbars", symbol="Mlc", source=_TABLE_3,
        assumed="nominal value (printed mean taken)",
    ),
    Parameter(
        "m_girder_ends", 38.0, 0.0, 60.0, "kg/m",
        description="additional mass of the girders outside the crossbars", symbol="Mle", source=_TABLE_3,
    ),
    Parameter(
        "m_crossbar", 70.8, 0.0, 250.0, "kg/m",
        description="additional mass of the crossbars", symbol="Mt", source=_TABLE_3,
        assumed="nominal value (so that the added masses sum to the printed 842 kg)",
    ),
    Parameter(
        "m_axle", 271.0, 0.0, 542.0, "kg/m", distribution="fixed",
        description="additional mass of the axles", symbol="Me", source=_TABLE_3,
        assumed="limits (deterministic in the source)",
    ),
)  # fmt: skip
"""Table 3."""

RIG: tuple[Parameter, ...] = (
    Parameter(
        "K_block", 12_000.0, 9_000.0, 15_000.0, "kN/m",
        description="vertical stiffness of one elastic block of the secondary suspension", symbol="Kb", source=_TABLE_5,
    ),
    Parameter(
        "K_contact", 25_250.0, 500.0, 50_000.0, "kN/m",
        description="contact of an elastic block with the wooden block on it, x and z", symbol="Kbtl", source=_TABLE_5,
        assumed="nominal value (printed mean taken)",
    ),
    Parameter(
        "pos_long_left", 5.0, 2.0, 8.0, integer=True,
        description="longitudinal place of the left actuator, in steps of 0.07 m", symbol="Pos_le", source=_TABLE_5,
        assumed="spacing of the positions 0.07 m",
    ),
    Parameter(
        "pos_long_right", 5.0, 2.0, 8.0, integer=True,
        description="longitudinal place of the right actuator, in steps of 0.07 m", symbol="Pos_ld", source=_TABLE_5,
        assumed="spacing of the positions 0.07 m",
    ),
    Parameter(
        "pos_lat_left", 0.0, -1.0, 1.0, integer=True,
        description="transverse place of the left actuator, in steps of 0.03 m", symbol="Pos_te", source=_TABLE_5,
        assumed="spacing of the positions 0.03 m",
    ),
    Parameter(
        "pos_lat_right", 0.0, -1.0, 1.0, integer=True,
        description="transverse place of the right actuator, in steps of 0.03 m", symbol="Pos_td", source=_TABLE_5,
        assumed="spacing of the positions 0.03 m",
    ),
    Parameter(
        "E_wood", 10.0, 4.0, 12.0, "GPa",
        description="Young's modulus of the wooden blocks under the actuators", symbol="Em", source=_TABLE_5,
    ),
)  # fmt: skip
"""Table 5."""
