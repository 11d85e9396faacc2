"""Usual column names in English, Turkish, French, German and Spanish.

Units in headers; words for roles.
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from typing import Final

from fg_orient.model.names import Role

#: Usual names of columns by key, in the spelling of :func:`plain`. Names X and Y alone
#: are treated separately, because offices exchange them, and image points also have them.
NAMES: Final[dict[str, str]] = {
    "id": """id | no | nr | name | number | point | point id | point no | point name | point number | label | gcp
        | gcp id | station | nokta | nokta no | nokta adi | nokta numarasi | nokta id | ykn no | punkt | punktnummer
        | punkt nr
        | punktnr | pkt | pkt nr | pktnr | nummer | numero | num | n | matricule | nom | point numero | punto | n punto
        | numero de punto | nombre | num punto | pt | pt no | pto | sira no | nokta ismi | no point | no du point""",
    "image": """image | image id | image name | img | photo | picture | scene | frame | goruntu | goruntu adi
        | goruntu no | resim | bild | bildname | bildnummer | foto | aufnahme | imagen | cliche | nom image
        | fotograf""",
    "role": """role | type | kind | use | class | rol | rolu | tur | turu | tip | tipi | kullanim | gorev | gorevi | art
        | typ | rolle | verwendung | nature | usage | emploi | tipo | uso | clase | status | durum""",
    "E": """e | east | easting | eastings | dogu | saga | saga deger | dogu deger | est | este | ost | ostwert
        | rechtswert | rechts | rw | coordonnee est | easting m | geometry east | e coordinate | hoch rechts""",
    "N": """n | north | northing | northings | kuzey | yukari | yukari deger | kuzey deger | nord | norte | nordwert
        | hochwert | hoch | hw | geometry north | n coordinate""",
    "H": """h | z | height | elevation | elev | alt | altitude | altitud | yukseklik | kot | kotu | hohe | hoehe
        | hauteur | cota | elevacion | altura | geometry height | up | rakim | ellipsoidal height | orthometric height
        | elipsoidal yukseklik | elipsoit yuksekligi | ortometrik yukseklik | ortometrik kot | ellipsoidische hohe
        | ellipsoidische hoehe | normalhohe | normalhoehe | nn hohe | hohe u nn | hohe uber nn | hohe nhn
        | hauteur ellipsoidale
        | altitude ngf | altura elipsoidal | cota ortometrica | altura ortometrica | hae | msl | z coordinate""",
    "lon": "lon | long | longitude | longitud | boylam | lambda | lange | laenge | geografische lange | lng | lon deg",
    "lat": "lat | latitude | latitud | enlem | phi | breite | geografische breite | lat deg",
    "x": "x | x koordinati | x coordinate | x koordinate | coord x | coordonnee x | coordenada x | x utm",
    "y": "y | y koordinati | y coordinate | y koordinate | coord y | coordonnee y | coordenada y | y utm",
    "line": """line | row | lin | satir | satir no | ligne | zeile | bildzeile | fila | linea | rows | lines | y pixel
        | pixel y | y px | py | v | r | y image | image y | piksel y | y piksel""",
    "sample": """sample | samp | col | column | sutun | kolon | colonne | spalte | bildspalte | columna | columns
        | samples | x pixel | pixel x | x px | px | u | c | x image | image x | pixel | piksel | x piksel | piksel x""",
}
_SIGMA: Final = frozenset("""sigma sd std stdev stddev se rmse mse s m precision accuracy sapma ss hata koh karesel
    ort genauigkeit standardabweichung mittlerer fehler ecart type desviacion error""".split())  # fmt: skip
_AXIS: Final = {
    "e": "sE", "east": "sE", "easting": "sE", "dogu": "sE", "est": "sE", "este": "sE", "ost": "sE", "rechtswert": "sE",
    "n": "sN", "north": "sN", "northing": "sN", "kuzey": "sN", "nord": "sN", "norte": "sN", "hochwert": "sN",
    "h": "sH", "z": "sH", "up": "sH", "height": "sH", "yukseklik": "sH", "kot": "sH", "hohe": "sH", "hoehe": "sH",
    "altitude": "sH", "cota": "sH", "hauteur": "sH", "u": "sH", "line": "sline", "sample": "ssample",
    "row": "sline", "col": "ssample",
    "satir": "sline", "sutun": "ssample", "zeile": "sline", "spalte": "ssample", "ligne": "sline", "colonne": "ssample",
    "xy": "sEN", "horizontal": "sEN", "yatay": "sEN", "lage": "sEN", "plan": "sEN", "konum": "sEN",
    "vertical": "sH", "dusey": "sH", "vertikal": "sH", "px": "spx", "pixel": "spx", "image": "spx", "piksel": "spx",
    "x": "sx", "y": "sy",
}  # fmt: skip
_SHORT: Final = re.compile(r"[sm](e|n|h|z|x|y|xy|en)")
#: Words in a header that give no information about the column.
_FILLERS: Final = frozenset("""coordinate coordinates koordinat koordinati koordinatlari koordinatlar koordinate
    koordinaten coordonnee coordonnees coordenada coordenadas coord value deger degeri wert valor valeur standart utm
    zone zon dilim wgs84 wgs itrf itrf96 itrf2005 etrs89 etrs ed50 rgf93 dhdn gk gauss kruger lambert tm tm3 tm30
    tm33
    ground arazi yer gelande terrain terreno the of de du des la le der die das sistem system jeodezik geodetic 32n 33n
    34n 35n 36n 37n 38n 30n 31n m deg dom""".split())  # fmt: skip
#: Factors of units to metres.
LENGTHS: Final = {
    "m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0, "mt": 1.0, "metros": 1.0, "km": 1000.0,
    "dm": 0.1, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "feet": 0.3048, "foot": 0.3048, "us ft": 1200.0 / 3937.0,
    "usft": 1200.0 / 3937.0, "ftus": 1200.0 / 3937.0,
}  # fmt: skip
#: Factors of angles to degrees, and forms with packed degrees, minutes and seconds.
ANGLES: Final = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "derece": "deg", "grad dezimal": "deg", "degre": "deg",
    "degres": "deg", "grados": "deg", "decimal degrees": "deg", "dd": "deg", "gon": "gon", "gons": "gon",
    "rad": "rad", "radian": "rad", "dms": "dms", "ddmmss": "dms", "dd mm ss": "dms", "d m s": "dms", "g m s": "dms",
    "gms": "dms", "dd.mmss": "d.mmss", "d.mmss": "d.mmss",
}  # fmt: skip
PIXELS: Final = frozenset(("px", "pixel", "pixels", "pix", "piksel", "pel", "pixeles"))
_ELLIPSOIDAL: Final = re.compile(r"\b(ellips\w*|elips\w*|hae|gnss height|gps height|wgs ?84 height|h ell)\b")
_ORTHOMETRIC: Final = re.compile(
    r"\b(ortho\w*|orto\w*|nn|nhn|dhhn\w*|ngf|ign ?69|msl|geoid\w*|geoit\w*|normalh\w*|sea level|deniz\w*|"
    r"nivel del mar|amsl|tudka\w*|evrf\w*)\b"
)
_ROLE_WORDS: Final = {
    Role.CONTROL: """control | gcp | ykn | kontrol | passpunkt | pp | pass | calage | appui | apoyo | kn | fixed | sabit
        | kontrol noktasi | control point | ground control point | point d appui | punto de apoyo | point de calage
        | punto de control | yer kontrol noktasi | vollpasspunkt""",
    Role.CHECK: """check | cp | icp | denetim | dn | check point | checkpoint | denetim noktasi | kontrollpunkt
        | kontrolle | chequeo | punto de chequeo | verification | test | bagimsiz | validation | contrôle
        | point de contrôle""",
    Role.TIE: """tie | tp | tie point | baglama | baglama noktasi | verknupfungspunkt | liaison | point de liaison
        | enlace | punto de enlace | tutturma""",
}
ROLE_WORDS: Final = {" ".join(word.split()): role for role, text in _ROLE_WORDS.items() for word in text.split("|")}


@dataclass(frozen=True)
class Named:
    """Content of a header: key of the column ("" if unknown), unit, and other words, for example an image name."""

    key: str
    unit: str = ""
    rest: str = ""
    heights: str = ""


def plain(text: str) -> str:
    """Return a text in lower case without accents and punctuation.

    Words are separated by one blank.
    """
    low = text.replace("İ", "i").replace("I", "i").lower().replace("ı", "i").replace("ß", "ss").replace("ø", "o")
    bare = "".join(c for c in unicodedata.normalize("NFKD", low) if not unicodedata.combining(c))
    return " ".join(
        re.sub(r"[^a-z0-9.°]+", " ", bare.replace("σ", " sigma ").replace("φ", "phi").replace("λ", "lambda")).split()
    )


_KEYS: Final = {" ".join(name.split()): key for key, names in NAMES.items() for name in names.split("|")}


def named(header: str) -> Named:
    """Return the key, the unit and the other words of a header."""
    unit, text = _unit(header)
    words = plain(text.replace(".", " ").replace("_", " ")).split()
    heights = heights_of(header)
    sigma = _sigma(words)
    if sigma:
        return Named(
            sigma, unit or (words[-1] if words[-1] in ("m", "cm", "mm", "px") and len(words) > 1 else ""), "", ""
        )
    if not unit and len(words) > 1 and (words[-1] in LENGTHS or words[-1] in ANGLES or words[-1] in PIXELS):
        unit = words.pop()
        if unit in PIXELS and words == ["x"]:
            return Named("sample", "px")
        if unit in PIXELS and words == ["y"]:
            return Named("line", "px")
    key, rest = _longest(words)
    if key in ("x", "y") and rest:  # with words as in "Y (right)" and "X (up)", the axes are clear
        inner = _longest(rest.split())
        key, rest = inner if inner[0] in ("E", "N") else (key, rest)
    if unit in PIXELS and key in ("x", "y"):
        key = "sample" if key == "x" else "line"
    return Named(key, "px" if unit in PIXELS else unit, rest, heights if key == "H" else "")


def heights_of(text: str) -> str:
    """Return the kind of heights that a text names: "ellipsoidal", "orthometric" or ""."""
    words = plain(text.replace("_", " "))
    ellipsoidal, orthometric = bool(_ELLIPSOIDAL.search(words)), bool(_ORTHOMETRIC.search(words))
    if re.fullmatch(r"(kot|kotu|rakim)( m)?", words):
        orthometric = True
    return "" if ellipsoidal == orthometric else "ellipsoidal" if ellipsoidal else "orthometric"


def _unit(header: str) -> tuple[str, str]:
    """Return the unit, which is in brackets or after a slash, and the header without it."""
    for found in re.finditer(r"[\[({]([^\[({\])}]*+)[\])}]", header):
        inner = found[1].strip()
        word = plain(inner)
        if inner in ("°", "º"):
            word = "deg"
        elif re.fullmatch(r"\W*°\W*'?\W*\"?\W*|° ' \"|g m s|d m s", inner):
            word = "dms"
        if word in LENGTHS or word in ANGLES or word in PIXELS:
            return word, header[: found.start()] + " " + header[found.end() :]
    return "", header


def _sigma(words: list[str]) -> str:
    """Return the key of a column of standard deviations; "" for other columns."""
    if words and _SHORT.fullmatch(words[0]) and not set(words[1:]) - {"m", "cm", "mm"}:
        axis = words[0][1:]
        return _AXIS.get("xy" if axis == "en" else axis, "")
    if (len(words) > 1 and set(words) & _SIGMA - {"m", "s", "error", "type"}) or (
        len(words) == 2 and words[0] in ("s", "m")
    ):
        keys = [_AXIS[word] for word in words if word in _AXIS]
        if keys[:2] in (["sx", "sy"], ["sE", "sN"]):
            return "sEN"
        axis = next(iter(keys), "")
        return axis if axis or len(words) > 2 else ""
    return ""


def _longest(words: list[str]) -> tuple[str, str]:
    """Find the longest usual name among the words; return its key and the remaining words."""
    for length in range(len(words), 0, -1):
        for k in range(len(words) - length + 1):
            key = _KEYS.get(" ".join(words[k : k + length]))
            if key:
                rest = [word for word in words[:k] + words[k + length :] if word not in _FILLERS]
                others = {_longest([word])[0] for word in rest} - {""} if length == 1 else set()
                if others - {key, "id"} and key == "id":
                    continue
                return key, " ".join(rest)
    return "", " ".join(words)


def role_of(cell: str) -> Role | None:
    """Return the role that a cell names in any of the languages; None for other words."""
    low = cell.strip().lower()
    return ROLE_WORDS.get(low) or ROLE_WORDS.get(plain(cell))
