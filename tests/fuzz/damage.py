"""Changes of bytes and texts: flipped, cut, moved, doubled, overwritten, and odd values in the place of usual ones."""

from __future__ import annotations

import random
import re
import struct

_NUMBERS = (
    0,
    1,
    2,
    0x7F,
    0x80,
    0xFF,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    (1 << 63) - 1,
    1 << 63,
    (1 << 64) - 1,
)
_FLOATS = tuple(
    struct.pack("<d", x)
    for x in (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0, 1e9)
)


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Return data with one to three parts of it changed."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        a = rng.randrange(len(data) + 1)
        b = min(a + int(2.0 ** rng.uniform(0.0, 13.0)), len(data))
        c = rng.randrange(len(data) + 1)
        d = min(c + b - a, len(data))
        kind = rng.randrange(12)
        if kind < 3 and a < len(data):
            data = data[:a] + bytes([data[a] ^ 1 << rng.randrange(8)]) + data[a + 1 :]
        elif kind == 3:
            data = data[:a]
        elif kind == 4:
            data = data[:a] + data[b:]
        elif kind == 5 and b <= c:
            data = data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]
        elif kind == 6:
            data = data[:a] + data[c:d] + data[a:]
        elif kind == 7:
            data = data[:a] + rng.randbytes(b - a) + data[b:]
        elif kind == 8:
            data = data[:a] + bytes([rng.choice((0, 255))]) * (b - a) + data[b:]
        elif kind == 9:
            size = rng.choice((1, 2, 4, 8))
            number = rng.choice(_NUMBERS) & ((1 << 8 * size) - 1)
            data = data[:a] + number.to_bytes(size, rng.choice(("little", "big"))) + data[a + size :]
        elif kind == 10:
            a -= a % 4  # where CDR has its numbers
            data = data[:a] + rng.choice(_FLOATS) + data[a + 8 :]
        else:
            data = data[:a] + rng.randbytes(min(b - a, 64)) + data[a:]
        if not data:
            break
    return data


_ODD = (
    "", "null", "true", "-1", "0", "1e400", "-.inf", ".nan", "1" * 5000, "0x7fffffffffffffffffff", "1e-320", "[]",
    "{}", "[1, [2, [3]]]", "{a: 1}", "'text'", "2001-13-45", "2001-01-01", "!!python/object:os.system x",
    "!!binary zz", "*gone", "&a [*a]", "<<: *x", "? x", "- - -", "\t", "\x00", "'" + "x" * 3000 + "'", "~", "1_000",
    "190:20:30", "0o17", "{[]: 1}", "&a [1,1,1,1,1]", "{<<: {a: 1}}", "é", "=", "%", "@", "`", "|", ">", "-", "1:1",
    "[" * 3000, "1e308", "-1e308", "1e-308", "0.1e1", "nan", "inf", "\u2028", "\ufeff", "\x1b[31m",
    "../../etc", "/dev/zero",
)  # fmt: skip
_BOMB = "&b0 [x,x,x,x,x,x,x,x,x,x]"


def mutated_text(text: str, rng: random.Random) -> str:
    """Return a text with one to three of its lines, values or characters changed."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = text.split("\n")
        k, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        numbers = list(re.finditer(r"(?<=[:\[, ])[-+.\w]+(?=[,\]}\n ]|$)", text))
        kind = rng.randrange(11)
        if kind == 0:
            lines[k], lines[other] = lines[other], lines[k]
        elif kind == 1:
            del lines[k]
        elif kind == 2:
            lines.insert(other, lines[k])
        elif kind == 3:
            lines[k] = " " * rng.randrange(9) + lines[k].lstrip()
        elif kind in (4, 5, 6) and numbers:
            match = rng.choice(numbers)
            text = text[: match.start()] + rng.choice(_ODD) + text[match.end() :]
            continue
        elif kind == 7:
            text = text[: rng.randrange(len(text) + 1)]
            continue
        elif kind == 8 and text:
            place = rng.randrange(len(text))
            text = text[:place] + chr(ord(text[place]) ^ 1 << rng.randrange(8)) + text[place + 1 :]
            continue
        elif kind == 9:
            bomb = [f"b{n}: &b{n} [{', '.join([f'*b{n - 1}'] * 10)}]" for n in range(1, 12)]
            lines[:0] = [f"b0: {_BOMB}", *bomb]
            lines[-1:] = [f"{lines[-1].split(':')[0] or 'name'}: *b11"]
        else:
            lines[k] = lines[k].split(":")[0] + ": " + rng.choice(_ODD)
        text = "\n".join(lines)
    return text


_PIECES = (
    "k", "z", "r", "Omega", "Ω", "rho", "theta", "up", "i", "pi", "t", "n", "x" * 70, "0", "1", "1e308",
    "1e-320", "1e400", "9" * 400,
    "+", "-", "*", "/", "^", "**", "(", ")", "((", "))", "|", ",", ";", ":", "=", "[", "]", "[N*m/rad]", "[1]",
    "max(", "min(",
    "sqrt(", "exp(", "log(", "sin(", "tanh(", "conj(", "abs(", "re(", "sign(", "/(1-1)", "/min(1,0)", "^1e9",
    "^-1", "²", "⁻¹", " ", "\n",
    "\x00", "__import__", ".", "..", "lambda", "'", '"', "\\", "torque =", "coil_gain =", "+-", "±", "{", "}",
    "%", "é", "\u202e",
)  # fmt: skip


def mutated_words(text: str, rng: random.Random) -> str:
    """Return a formula, or another short text that people type, with one to four parts of it changed."""
    for _ in range(rng.choice((1, 1, 2, 3, 4))):
        words = re.findall(r"\w+|\s+|[^\w\s]", text) or [""]
        k, other = rng.randrange(len(words)), rng.randrange(len(words))
        kind = rng.randrange(7)
        if kind == 0:
            words[k] = rng.choice(_PIECES)
        elif kind == 1:
            words.insert(k, rng.choice(_PIECES))
        elif kind == 2:
            del words[k]
        elif kind == 3:
            words[k], words[other] = words[other], words[k]
        elif kind == 4:
            words[k:k] = words[min(k, other) : max(k, other)]
        elif kind == 5:
            words[k] = f"{rng.uniform(-9, 9):.{rng.randrange(18)}e}"
        else:
            words = words[:k]
        text = "".join(words)
    return text
