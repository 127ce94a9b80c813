"""Named sets of PandaSet's sequences, as UniSim's supplement (section on data) chose them."""

from __future__ import annotations

PANDASET = tuple(
    """
    001 002 003 004 005 006 008 011 012 013 014 015 016 017 018 019 020 021 023 024 027 028 029 030 032 033 034 035 037 038 039
    040 041 042 043 044 045 046 047 048 050 051 052 053 054 055 056 057 058 059 062 063 064 065 066 067 068 069 070 071 072 073
    074 077 078 079 080 084 085 086 088 089 090 091 092 093 094 095 097 098 099 100 101 102 103 104 105 106 109 110 112 113 115
    116 117 119 120 122 123 124 139 149 158
    """.split()
)
"""All 103 sequences."""

SEED10 = tuple("001 011 016 028 053 063 084 106 123 158".split())
"""Sequences of the image metrics; 063 is at night, 028 has no actors."""

SEED24_VALIDATION = tuple(
    "001 011 013 016 017 028 029 032 053 054 063 065 068 072 084 086 090 103 106 110 112 115 123 158".split()
)
"""Sequences on which perception is validated."""

SEED24_TRAINING = tuple(sequence for sequence in PANDASET if sequence not in SEED24_VALIDATION)
"""The other 79 sequences."""

SPLITS = {
    "pandaset": PANDASET,
    "seed10": SEED10,
    "seed24-validation": SEED24_VALIDATION,
    "seed24-training": SEED24_TRAINING,
}
