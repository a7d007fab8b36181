"""A MuJoCo digital twin of milling robots.

Data flows one way: description → model → prediction; recording → residual → verdict.
"""

__version__ = "0.1.0"
