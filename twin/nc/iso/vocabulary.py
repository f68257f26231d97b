"""The vocabulary of ISO programs: tokens of a block, and the meaning of Fanuc, LinuxCNC and Siemens 840D words."""

from __future__ import annotations

import re
from collections.abc import Mapping

from twin.nc.text import line_pattern, number

_STRING = r'"[^"\r\n]*+"'
_ARGS = rf'\((?:[^()"\r\n]++|{_STRING}|\((?:[^()"\r\n]++|{_STRING}|\([^()"\r\n]*+\))*+\))*+\)'
BRACKET = r"\[[^\[\]\r\n]*+\]"
for _ in range(6):
    BRACKET = rf"\[(?:[^\[\]\r\n]++|{BRACKET})*+\]"
_NUMBER = r"[\d.]++"
_HASH = r"\#(?:\d++|<[^>\r\n]*+>)"
_NAME = rf"\$?[A-Za-z_]\w*+(?:{BRACKET})?+(?:{_ARGS})?+"
_OPERAND = rf"[+-]?+[ \t]*+(?:{_NUMBER}|{_STRING}|{_NAME}|{_HASH}|{BRACKET})"
_REST = r"(?:(?![A-Za-z][ \t]*+[+-]?[ \t]*+[\d.\#\[])[^()\r\n])*+"
_INNER = rf"\([^()\r\n]*+(?:\([^()\r\n]*+\){_REST})*+\)"
NOTE = rf"\([^()\r\n]*+(?:{_INNER}{_REST})*+\)"
"""A comment. One within it ends the outer one on some controls: nothing behind it in the outer one may be a word."""
_OPERATOR = r"[ \t]*+(?:\*\*|[-+*/]|(?:[Mm][Oo][Dd]|[Dd][Ii][Vv])(?!\w))"
_EXPRESSION = rf"{_OPERAND}(?:{_OPERATOR}{_OPERAND})*+"
_GROUPED = rf"(?:[+-]?+[ \t]*+{_ARGS}|{_OPERAND})"
_FORMULA = rf"{_GROUPED}(?:{_OPERATOR}[ \t]*+{_GROUPED})*+"

TOKEN = re.compile(
    rf"""[ \t\f\x1a]*+(?:
      (?P<word>([A-Za-z])[ \t]*+([+-]?+[ \t]*+[\d.]++)(?![ \t]*+=))
    | (?P<note>{NOTE}|;[^\r\n]*+|[\r\n]++)
    | (?P<given>([A-Za-z]\d*+|\$?[A-Za-z_][A-Za-z_]\w*+)({BRACKET})?+[ \t]*+=(?!=)[ \t]*+({_FORMULA}))
    | (?P<name>(\$?(?:[A-Za-z][A-Za-z_]|_)\w*+)({BRACKET})?+(?:[ \t]*+({_ARGS}))?+)
    | (?P<late>([A-Za-z])[ \t]*+([+-]?+[ \t]*+(?:{_HASH}|{BRACKET})))
    | (?P<hash>({_HASH})[ \t]*+=[ \t]*+({_EXPRESSION}))
    | (?P<skip>(?:/\d?+)++)
    | (?P<main>:\d*+)
    | (?P<polar>[@^][ \t]*+(?:[+-]?+[ \t]*+[\d.]++|[+-]?+[ \t]*+(?:{_HASH}|{BRACKET})))
    | (?P<bad>\S)
    )""",
    re.VERBOSE | re.ASCII,
)
"""One token with the spaces before it: ``X1.5``; a comment or line end; ``X=..``, ``R1=..``, ``_X_HOME=..``; a name, with or
without arguments; ``X#100``, ``X[..]``; ``#100=..``; ``/``; ``:``; ``@1.5``, ``^30``; and any other character.
"""

LITERAL = re.compile(r"[+-]?[ \t]*+[\d.]++", re.ASCII)
WRAPPED = re.compile(r"(AC|IC|DC|ACP|ACN)[ \t]*+\([ \t]*+(.*?)[ \t]*+\)", re.IGNORECASE | re.ASCII)
ASSIGNED = re.compile(r"([A-Za-z_]\w*+)[ \t]*+=[ \t]*+([+-]?[\d.]++)", re.ASCII)

# G codes by modal group. Two of one group in a block contradict each other; "" means no group.
GROUPS: dict[str, tuple[str, ...]] = {
    "motion": (
        "0",
        "1",
        "2",
        "3",
        "33.1",
        "73",
        "74",
        "76",
        "81",
        "82",
        "83",
        "84",
        "84.2",
        "84.3",
        "85",
        "86",
        "87",
        "88",
        "89",
    ),
    "plane": ("17", "18", "19"),
    "units": ("20", "21", "70", "71", "700", "710"),
    "distance": ("90", "91"),
    "arc centre": ("90.1", "91.1"),
    "feed": ("93", "94", "95"),
    "spindle": ("96", "97", "961", "962", "971", "972"),
    "radius": ("40", "41", "42"),
    "length": ("43", "43.1", "43.4", "43.5", "44", "49", "234", "169", "170"),
    "return": ("98", "99"),
    "offset": (
        *("54", "55", "56", "57", "58", "59", "54.1", "59.1", "59.2", "59.3", "154", "500"),
        *(str(code) for code in range(505, 600)),
    ),
    "machine": ("53", "153"),
    "plane tilt": ("68.2", "53.1", "53.3", "53.6", "69", "253", "254", "255", "268", "269"),
    "shift": ("10", "52", "92", "92.1", "92.2", "92.3"),
    "still": ("4", "22", "23", "25", "26"),
    "pole": ("110", "111", "112"),
    "reference": ("28", "28.2", "30", "30.1", "75", "27", "31", "38", "38.2", "38.3", "38.4", "38.5"),
    "mode": ("61", "61.1", "62", "64", "60", "641", "642", "643", "644", "645"),
    "": (
        *("5.1", "5.4", "5", "8", "9", "13.1", "15", "40.1", "50", "50.1", "50.2", "67", "69.1", "80", "80.5"),
        *("65", "601", "602", "603", "103", "187", "450", "451", "460", "461", "462", "621", "340", "341"),
    ),
}
"""The G codes whose effect is known. Every other one is refused (`REFUSED_CODES`), or nothing is known after it.

Haas alone has G103 (blocks read ahead), G154 P (further work offsets), G187 (smoothness) and G234; no other control gives them another
meaning in public.
"""
GROUP_OF: dict[str, str] = {code: group for group, codes in GROUPS.items() for code in codes}

EXPANDED_CYCLE = "a cycle expanded into G0 and G1 blocks by the postprocessor"
LINEAR = "a path of G0, G1, G2 and G3 blocks from the postprocessor"
KNOWN_VALUE = "a number, or a variable set to a number before"
NO_TRANSFORMATION = "a program without coordinate transformations (at most one work offset, given as work_offset)"
NO_CALLS = "one program without jumps or calls"


FLAGS: frozenset[str] = frozenset({"5.1", "8", "50", "50.1", "103", "187"})
"""G codes with which words of axes are no positions: they name the axes to smooth, or whose scaling or mirroring ends."""

OWN_WORDS: Mapping[str, str] = {"5.1": "QR", "187": "PE"}
"""Words that belong to a G code of smoothing in its block: mode and level, smoothness and tolerance."""
OWN_OF_M: Mapping[str, str] = {"M19": "R", "M61": "Q", "M66": "PLEQ", "M67": "EQ", "M68": "EQ"}
"""Words of an M word: angle of the spindle; of LinuxCNC the tool in the spindle, inputs, and analogue outputs."""
LINUXCNC_VARIABLES = (31, 5000)
"""Variables of a program of LinuxCNC without an effect of their own."""
ENDED_BY_P0: frozenset[str] = frozenset({"54.2", "54.4"})
"""G codes of Fanuc and Mazak that shift coordinates by a table, and end that with P0."""
SMOOTHING_BY_P: frozenset[str] = frozenset({"5.3"})
"""G codes that set a surface quality by P alone (Hurco), and begin a curve without it (LinuxCNC)."""
OFFSET_VARIABLES = ((2001, 2999), (5161, 5400), (7001, 7960), (10001, 13999), (14001, 19988))
"""System variables that hold work offsets and tool lengths (LinuxCNC: 5161 to 5400)."""
USER_VARIABLES = ((0, 999), (3000, 3012), (3901, 3902), (98000, 98499))
"""Variables without an effect of their own: local and common ones, messages, timers, counters of parts (Fanuc 30i, Haas, LinuxCNC)."""

REFUSED_CODES: dict[str, tuple[str, str]] = {
    **{code: (f"thread or tapping G{code}", LINEAR) for code in ("33", "34", "35", "63", "331", "332", "32", "92.5")},
    **{
        code: (f"curve G{code}", LINEAR)
        for code in ("2.2", "2.3", "2.4", "3.2", "3.3", "3.4", "5.2", "5.3", "6.1", "6.2")
    },
    **{code: (f"curve G{code}", LINEAR) for code in ("12", "13", "147", "148", "247", "248", "347", "348")},
    **{
        code: (f"coordinate transformation G{code}", NO_TRANSFORMATION)
        for code in (
            *("7", "7.1", "10.6", "10.9", "11", "12.1", "16", "51", "51.1", "54.2", "54.4"),
            *("68", "68.1", "68.3", "68.4", "107"),
        )
    },
    **{
        code: (f"cutter radius compensation G{code}", "the tool centre path from the CAM system (G40)")
        for code in ("41.1", "41.2", "42.1", "42.2", "43.2", "43.3")
    },
    "29": ("return from the reference point G29", "a G0 block with the position"),
    **{code: (f"macro call G{code}", NO_CALLS) for code in ("66", "66.1", "72.1", "72.2")},
}
OKUMA_HEADER = re.compile(r"\$[^=%\s]++%", re.ASCII)
"""The first line of a program of Okuma: its file name."""
NOT_OF_OKUMA: frozenset[str] = frozenset(
    {*(str(code) for code in range(53, 60)), *(str(code) for code in range(71, 90)), "98", "99", *GROUPS["shift"]}
    - {"80", *("53", "56")}
)
"""G codes that have another meaning on an OSP: tool length offsets and their end, return levels, shifts, cycles with own levels."""
PROGRAM_NAME = re.compile(r"<[\w.+-]++>[ \t]*+(?:\([^()]*+\))?+", re.ASCII)
"""A line with the name of a program, of Fanuc and Mazak, in place of its number."""
OKUMA_CODES: Mapping[str, str] = {"56": "43", "53": "49"}
"""G codes of Okuma by those of Fanuc: the tool length offset G56 H, and its end."""
OKUMA_LENGTHS: frozenset[str] = frozenset({"HA", "HB", "HC"})
"""Names of the three length offsets of the tool in the spindle (Okuma)."""
REFUSED_M: frozenset[str] = frozenset({"M97", "M96"})
CALLING_M: frozenset[str] = frozenset({"M98", "M198"})
"""M words that call the program P."""
O_CALL = re.compile(r"[Oo][ \t]*(\d+|<[^>]*>)[ \t]*(?:CALL)(?!\w)", re.ASCII | re.IGNORECASE)
O_SUB = re.compile(r"[Oo][ \t]*(?:\d+|<[^>]*>)[ \t]*SUB(?!\w)", re.ASCII | re.IGNORECASE)
MAIN_PROGRAM = "the program that calls this subprogram, with this file beside it"
CALLED_BY_NAME = re.compile(r"CALL[ \t]*+\(?+[ \t]*+\"([^\"]++)\"", re.ASCII | re.IGNORECASE)
SAVING_M: frozenset[str] = frozenset({"M70", "M71", "M72"})
"""M codes of LinuxCNC that save modal words, forget and restore them."""
POLAR = "@"
"""Form of the words of X and Y in place of polar words (LinuxCNC)."""
HARMLESS_M: frozenset[str] = frozenset(
    f"M{code}"
    for code in (
        # stops and ends, spindle, tool change, coolant, clamps of axes (ISO 6983, DIN 66025; M12 to M14: Haas, Okuma)
        *range(15),
        *(17, 19, 29, 30),  # end of a subprogram, spindle orientation, rigid tapping, end of the program
        *(31, 32, 33),  # chip conveyor (Haas)
        *range(40, 46),  # gear of the spindle (DIN 66025)
        # overrides, adaptive feed, feed hold, stop for a pallet (LinuxCNC); coolant elsewhere
        *(*range(48, 54), 60),
        *range(61, 69),  # tool in the spindle, digital and analogue inputs and outputs (LinuxCNC)
        *(70, 83, 84, 88, 89),  # a SINUMERIK spindle as an axis; air jet and coolant through the spindle (Haas)
        99,  # return, or repetition from the start
    )
)
"""M codes that leave positions, frames, offsets and modes alone. Others: `twin.nc.modal.SWITCHING_M`."""
END_M: frozenset[str] = frozenset({"M2", "M30", "M17", "M99"})
"""M words behind which nothing of a program is executed: its end, or its return if it is called (M99 otherwise begins again)."""
NAME_BEHIND_O = re.compile(r"O[ \t]*[A-Z_][^<;]*+", re.ASCII | re.IGNORECASE)
"""A name in place of a program number, or a number that was never entered."""
PROGRAM_BEGIN = re.compile(r"(?:[O:][ \t]*\d|<[^<>]*>|PROC\b)", re.IGNORECASE)
"""Beginning of a program or subprogram, beside a line with ``%``."""
LAST_M: frozenset[str] = frozenset(
    {"M0", "M1", "M2", "M5", "M9", "M30", "M60", "M17", "M99", "M00", "M01", "M02", "M05", "M09"}
)
"""M words that take effect after the motion of the block; in a block that is split they go with the last segment."""

# Names (Siemens 840D). PASSED do not change the meaning of axis words.
PASSED: frozenset[str] = frozenset(
    """MSG DEF FNORM FLIN FCUB FPO COMPOF COMPON COMPCURV COMPCAD COMPSURF SOFT BRISK DRIVE SOFTA BRISKA DRIVEA FFWON
    FFWOF NEWCONF STOPRE CUT2D CUT2DF CUT3DC CUT3DF CUT3DFF CUT3DFS ORIWKS ORIMKS ORIAXES ORIVECT ORIPLANE ORIEULER
    ORIRPY ORIRPY2 ORIVIRT1 ORIVIRT2 ORISON ORISOF OST OSOF OSC OSS OSSE OSD WALIMON WALIMOF SETMS LIMS SPOS SPOSA
    WAITS WAITM WAITE STARTFIFO STOPFIFO FIFOCTRL DISPLOF DISPLON EXTERN PROC RET SAVE SBLOF SBLON NORM KONT KONTT
    KONTC CFC CFTCP CFIN FGROUP FGREF FL FA FB FZ ACC VELOLIM JERKLIM RTLIOF RTLION ADIS ADISPOS WORKPIECE UPATH SPATH
    DIAMOF DYNNORM DYNFINISH DYNROUGH DYNSEMIFIN DYNPOS DYNPREC TRAFOOF TRAORI SUPA CYCLE832 CYCLE_HSC CTOL OTOL OVR
    OVRRAP OVRA SVC FD FDA GROUP_BEGIN GROUP_END GROUP_ADDEND TOROTOF PAROTOF TOFRAMEOF ENDPROC MIRROROF EXTCLOSE
    SETPIECE GETT GETSELT SETAL STOLF CUTMOD CUTMODK TOWSTD CDOF CDON CDOF2 CPRECON CPRECOF BLSYNC FTOCOF TLIFT
    FENDNORM NURBSOF BNAT BTAN BAUTO ENAT ETAN EAUTO ORIC ORID WAITP SPCON SPCOF""".split()
)
CONTROL_FLOW: frozenset[str] = frozenset(
    """IF ELSE ELSEIF ENDIF WHILE ENDWHILE FOR ENDFOR LOOP ENDLOOP REPEAT REPEATB UNTIL GOTO GOTOB GOTOF GOTOC GOTOS
    CASE DO CALL PCALL ISOCALL EXTCALL CALLPATH SUB ENDSUB RETURN BREAK CONTINUE WHEN WHENEVER EVERY ID IDS THEN AND
    OR XOR NOT EQ NE GT GE LT LE MOD EXECTAB EXECUTE""".split()
)
TRANSFORMS: frozenset[str] = frozenset(
    """ROT AROT ROTS AROTS CROTS RPL TRANS ATRANS CTRANS MIRROR AMIRROR SCALE ASCALE CYCLE800 TOROT TOROTX TOROTY TOROTZ
    TOFRAME TOFRAMEX TOFRAMEY TOFRAMEZ PAROT OFFN TRANSMIT TRACYL TRAANG TCARR TCOABS TCOFR TOFF TOFFL TOFFLR DIAMON
    DIAM90 PRESETON PRESETONS MEAFRAME TCOFRX TCOFRY TCOFRZ TOFFON TRACON TRAFOON""".split()
)
CANCELLING: frozenset[str] = frozenset("ROT TRANS MIRROR SCALE CYCLE800".split())
"""Transformations that cancel themselves if nothing follows them."""
CURVES: frozenset[str] = frozenset(
    """CIP CT ASPLINE BSPLINE CSPLINE POLY POLYPATH PW SD PL PO INVCW INVCCW RND CHF CHR ANG1 ANG2
    OEMIPO1 OEMIPO2 POS POSA POSP MOV OSCTRL FOCON FXS LEAD TILT THETA AN PHI PSI ORICURVE ORICONCW ORICONCCW ORICONIO
    ORICONTO ORIPATH ORIPATHS XH YH ZH NUT SPIF1 SPIF2 SPN SPP MEAS MEAW MEASA MEAWA MEAC PUNCHACC""".split()
)
CORNERS: frozenset[str] = frozenset({"RND", "CHF", "CHR"})
"""Rounding and chamfer at the end of a block: the blocks next to them stay whole."""
SPLINES: frozenset[str] = frozenset({"ASPLINE", "BSPLINE", "CSPLINE"})
SHAPED: frozenset[str] = SPLINES | {"CT"}
"""Paths that the control finds from the ends of blocks, and those before and after them; in force until the next motion word."""
SPLINE_WORDS: frozenset[str] = frozenset({"PW", "SD", "PL"})
"""Words of a spline that do not move its points: weight, degree, length of the parameter's interval."""
PATH_WORDS: frozenset[str] = frozenset({"AP", "RP", "AR", "ANG", "I1", "J1", "K1"})
"""Words in place of an end point or of a centre: polar angle and radius, opening angle, direction of a line, intermediate point."""
SHAPING = re.compile(r"[^(;]*(?<!\w)(?:CT|[ABC]SPLINE)(?!\w)", re.ASCII | re.IGNORECASE)
CYCLE = re.compile(r"CYCLE\d+|MCALL|HOLES\d|POCKET\d|SLOT\d|LONGHOLE|POLY_\w+|CONTPRON|CONTDCON", re.ASCII)

EVIDENCE = line_pattern(
    r"(?:[A-FH-Z][ \t]*+[+-]?+[\d.]++[ \t]*+)*+G[ \t]*+\d",
    r"%",
    r"O[ \t]*+(?:\d{2}|<)",
    r"\$\w[^%\r\n]*+%",
    r"(?:\#\d++|\#<[^>\r\n]*+>|R\d++)[ \t]*+=",
    rf"(?:{'|'.join(sorted(PASSED | TRANSFORMS))}|CYCLE\d++|MCALL)[ \t]*+(?=[(;\r\n]|\Z|[A-Z]\d?+[ \t]*+=?+[ \t]*+[+-]?+\d)",
    r"DEF[ \t]++(?:REAL|INT|BOOL|CHAR|STRING|AXIS|FRAME)(?!\w)",
)
"""A line of an ISO program: a G word after words of letters and numbers; tape mark; program number; header of Okuma; parameters; a
statement of SINUMERIK.
"""

HARMLESS_SYSTEM_VARIABLES: tuple[str, ...] = ("$AC_MARKER", "$AC_PARAM", "$AC_TIMER", "$A_OUT", "$A_DB")
"""Beginnings of system variables of SINUMERIK that hold numbers of the program, or go to the machine's outputs."""
CHANGING_KEYWORDS: frozenset[str] = frozenset({"DL"})
"""Keywords of SINUMERIK, set with ``=``, that change the length of the tool in the spindle."""

TCP_ON: frozenset[str] = frozenset({"G43.4", "G43.5", "G234", "G169", "TRAORI"})
TCP_OFF: frozenset[str] = frozenset({"G49", "G170", "TRAFOOF"})
"""Words that switch tool centre point control on and off."""
DIRECTION_FORMS: frozenset[str] = frozenset({"DC", "ACP", "ACN"})
"""Forms that give the direction in which a rotary axis turns to its value."""


def canonical(word: str) -> str:
    """Return a word in the form of the tables: ``g01`` and ``G 1`` are ``G1``, ``G43.40`` is ``G43.4``."""
    word = word.strip().upper()
    if len(word) > 1 and word[0] in "GM":
        value = number(word[1:])
        if value == value and value >= 0:
            return f"{word[0]}{value:g}" if value < 1e5 else f"{word[0]}{value:.0f}"
        return word[0] if not word[1:2].isalpha() else word
    return word
