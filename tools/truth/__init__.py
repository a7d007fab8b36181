"""Independent truth: from a chain's description to hammer tests and motion logs, in numpy alone.

Shares nothing with the twin and uses no MuJoCo. `chain` is the rigid robot, `effects` the physics that can be
concealed, `elastic` the flexible robot and its FRFs, `blows` hammer blows in time, `recording` the campaign
file, `motion` the motion logs. `python -m tools.truth --help` writes files.
"""
