"""Formulas of the registry, which are plain text, as mathematics: one translation for all fields."""

import re

GREEK = {
    "alpha", "beta", "gamma", "delta", "epsilon", "eta", "theta", "lambda", "mu", "nu", "rho", "sigma", "tau", "phi",
    "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda", "Sigma", "Phi", "Psi", "Omega",
}  # fmt: skip
NAMES = {
    "sum": r"\sum",
    "int": r"\int",
    "d43": "d_{43}",
    "d32": "d_{32}",
    "D2min": r"D^2_{\min}",
    "ds": r"\,ds",
}
FUNCTIONS = {"tr", "det", "dev", "curl"}
RELATIONS = {"=": "=", "+": "+", "-": "-", ":=": ":=", "<=": r"\le", ">=": r"\ge", ",": ","}
PRODUCTS = {":": "{:}", ".": r"\cdot", "x": r"\times"}
CLOSING = {"(": ")", "[": "]", "<": ">", "|": "|"}
BRACKETS = {
    "(": ("(", ")"),
    "[": ("[", "]"),
    "<": (r"\langle", r"\rangle"),
    "|": (r"\lvert", r"\rvert"),
}
TOKEN = re.compile(r"\s*(`\w+`|\d+D\b|\d+|[A-Za-z]\w*'?(?:_\w+|s\b)?|<=|>=|\S)")


def mathematics(formula: str) -> str:
    """Formula as Markdown: mathematics between dollars, with the words between them."""
    parts: list[tuple[bool, list[str]]] = []  # whether it is of words, and its tokens
    depth = 0
    tokens = TOKEN.findall(formula)
    for token, following in zip(tokens, [*tokens[1:], ""], strict=True):
        depth += (token in "([") - (token in ")]")
        before = parts[-1] if parts else (False, [])
        article = token == "a" and following and _is_word(following)
        words = not depth and (
            article or _is_word(token) or token in (",", ";") or (before[0] and token == ":")
        )
        if not parts or words != before[0]:
            parts.append((words, []))
        parts[-1][1].append(token)
    out = ""
    for words, tokens in parts:
        text = (
            " ".join(f"`{t}`" if "_" in t and t[0] != "`" else t for t in tokens)
            if words
            else f"${_Reader(tokens).all()}$"
        )
        out += re.sub(r"^ (?=[,;:])", "", f" {text}")
    return re.sub(r" ([,;:])", r"\1", out).strip()


def _is_word(token: str) -> bool:
    """Whether a token is of English, and no symbol."""
    if token.startswith("`") or re.fullmatch(r"\d+D", token):
        return True
    base = token.split("_")[0].rstrip("'")
    if base in GREEK | FUNCTIONS | set(NAMES) | {"sqrt"}:
        return False
    return token[0].isalpha() and len(base) > 1


def _symbol(token: str) -> str:
    """One letter, or a name, with its index."""
    if _is_word(token):
        return rf"\text{{{token.strip('`').replace('_', ' ')}}}"
    base, _, index = token.partition("_")
    base, prime = base.rstrip("'"), "'" * base.count("'")
    if index == "bar":
        return rf"\bar {base}"
    if base in NAMES:
        base = NAMES[base]
    elif base in GREEK | FUNCTIONS:
        base = f"\\{base}" if base in GREEK else rf"\operatorname{{{base}}}"
    if not index:
        return base + prime
    return f"{base}{prime}_" + (f"{{{index}}}" if len(index) < 3 else rf"{{\mathrm{{{index}}}}}")


class _Reader:
    """Reads tokens of one formula from left to right; fractions end with a factor, or with all of a sum."""

    def __init__(self, tokens: list[str]) -> None:
        self.tokens, self.place = tokens, 0

    def next(self) -> str:
        return self.tokens[self.place] if self.place < len(self.tokens) else ""

    def take(self) -> str:
        self.place += 1
        return self.tokens[self.place - 1]

    def all(self) -> str:
        out = []
        while self.next():
            out.append(self.terms(""))
            if self.next():
                out.append(self.take())  # a bracket that words opened
        return " ".join(filter(None, out))

    def terms(self, end: str) -> str:
        """Products between relations and signs, up to a closing bracket."""
        out = []
        while self.next() and self.next() not in (end, ")", "]"):
            token = self.next()
            if token in RELATIONS or (token == ">" and end != ">"):
                out.append(RELATIONS.get(self.take(), ">"))
            else:
                out.append(self.product(end))
        return " ".join(out)

    def product(self, end: str) -> str:
        done = []  # what stands before a fraction, and what its numerator may be
        factors = []
        while self.next() and self.next() not in (end, ")", "]", ">", *RELATIONS):
            if self.next() != "/" or not factors:
                factors.append(self.factor())
                continue
            self.take()
            below = self.product(end) if self.next().startswith("sum") else self.factor(bare=True)
            more = self.next() and self.next() not in (end, ")", "]", ">", *RELATIONS)
            if more and factors[0].startswith(r"\sum"):  # the sum goes on behind the fraction
                done += factors[:-1]
                factors = factors[-1:]
            above = " ".join(factors)
            whole = re.fullmatch(r"\(((?:[^()]|\([^()]*\))*)\)", above)
            done.append(rf"\dfrac{{{whole[1] if whole else above}}}{{{below}}}")
            factors = []
        return " ".join([*done, *factors])

    def factor(self, *, bare: bool = False) -> str:
        """One symbol, number or bracket, with its power; without its parentheses where it is `bare`."""
        token = self.take()
        if token == "sqrt" and self.next() == "(":
            return rf"\sqrt{{{self.factor(bare=True)}}}"
        if token in CLOSING:
            inside = self.terms(CLOSING[token])
            if self.next() == CLOSING[token]:
                self.take()
                opened, closed = BRACKETS[token]
                alone = bare and token == "(" and self.next() != "^"
                space = "" if token in "([" else " "
                text = inside if alone else f"{opened}{space}{inside}{space}{closed}"
            else:
                text = f"{token}{inside}"  # closed behind words
        else:
            text = PRODUCTS.get(token) or _symbol(token)
        while self.next() == "^":
            self.take()
            sign = self.take() if self.next() == "-" else ""
            text = f"{{{text}}}" if "'" in text else text  # a prime is an exponent as well
            text += f"^{{{sign}{_symbol(self.take())}}}"
        return text
