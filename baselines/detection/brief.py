"""BRIEF: a patch as the signs of 512 comparisons of smoothed brightness (Calonder et al. 2010).

The places compared are those of OpenCV's contributed extractor of 64 bytes (Apache 2.0), not newly drawn ones, since
descriptors can be matched only with others of the same places, and models made with OpenCV are to be read
(`FeatureModel.read_opencv`).
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

BORDER = 28
"""Distance [px] from the image's edge within which a patch does not fit: half of 48, and half of the 9 of smoothing."""

SMOOTHING = 9  # [px] edge of the box whose sum is compared
REACH = 24  # [px] farthest that a comparison lies from the keypoint along either axis

# The places compared, (512, 4) int8: y, x of the first, y, x of the second. The paper draws them at random.
_PLACES = (
    "c-j?}*LLeV5=0vrAQ(jJTGs#nosK1049ICPuLKuXp}J~!ZKCb15L7ir+=dA^*cmHTVrt~Z;zPQVTUnY!gfku@OSfwLEF^1l+INLPlpBxSr=&zH!M"
    "<q%jfom8p$f)wMT<#u6H+`9gJ{<&mwciVgCw_OBJH#CK`aUId95VoO%j-?VN3^s`1nl<o)JSylfQ_$WOlDWSr;-;8g3xot-x2lC4vGj*XLS^_4l+"
    "3R>!>25nlgIg!z*};=yoJ{w;JsAus&`xD$S>$4v7f-~U<*<aJUahpEOE6aFoj2Drp@Hq_Kt7!0T68s0233QsD`*Z5rD0xwtd=7D6iPb<MbbSGC=r"
    "H^f_wDBsq^es5)7Jysc_C{*RYw%TN7KBKX*E)k_#zh>-v%hkPaTBp%q@iGO&J03pAK>!VKU{(RJ@(_}2U88V6ACk&C?zUnYiYry2}|Pe4#zQ|Hrd"
    "xK_k0M1>KI5usa9$6ECo>#JM;z$Xau#}!&Q#hFqHU7nkRS+2v4b~+>SI%MqdAOn0j#guw3`kmPc7@F?_$)j1waVu8FR6HKC#(Iib&y&>!W#Bv-A2"
    "P#G|sKb+vLj@=gA1^GIr>ZMcI5|jr=`G{HZz>Yr5X8UZVvyc97Dg=YhVZpXM{n6*d%-_+yp(n7m$E+cfL6qs+@bexry^y`Ia6%U8&rRVL4a5G&2;"
    "1gjB{@)p@XPnFYmS3xxqYK#xv5{>yyDVu%xlrF_LlYifK**J*w4Jg0vkBGxu%J>pCGEWH5K-l{AM=I<EK>2$Isn@?D2gCc2Px%@FCc$ZzP2PwE9t"
    "T9elik>X}UjWSz&l#h%sQHOFAx9yYt}A+a;Vk{OPV{2Qrd8>gkQe0}7+P6my1H}N@8M*j0pf?i6MuSMtaBE{~Dihwh+4a*R})EFKzGVJ&nS`An!v"
    "2YyuWrQmw9BRXBZ#X)e0fU8V<VBll1X-Ia;hG5N?|ZeSyyIa*!$C!y`9b?>#%eMw8d|k`!6T(mV$9<_8vprSPF|b8@a8LOPLf<}0P3|lF(z7s>>>"
    "#XNU*6hrrXAl0(6nolugMMuv??C1);^CN2QTQ+dGp6E>#lm5(%UBNX6g}h~ISVd(KpeLiLdOs#Yt(#7~q58xq0eW%3XQ=xAd@)!`t$;AOAoqNCtt"
    "k+#V3Joqk5@=-)i^3e5MhUss>G9j9GnJ{&+biGi$rJlJv?g7qg!ZSFfJ61d@RQ(PZH>&RhSHJF-vqR_s8s(Osm2uMKhH}tIGvMcdN^P{7HVXfIV{"
    "rIrA52>MTO`?!lP}m~&Tr*WLxjmj&V?PLs2cv&zue4Ty%@(NdItjsS$_C9nO{4|0%8#zV83=W$w<S%^h$}QAKwX*=TXWrFjCX=RB<$fvPt7{I`cs"
    "VEag*ho#}ot2l*M)3o}OMa6Qa2LrtAov9iOPE&QPl-NT9#j-QDCLP3PuiO%s=8&iHrqA{WD6$Hz{pk{E(x(Qs-)5ZLj?@#Txi!H<Fo^ox<<G5%FM"
    "R06`8{>WPZE<B=leTr*Xt(R}Az?4cx<qPg6v<Jk-K_-}onrIXL8c9#E~gRhv{#JE94@T+T))yPtE(iSnErMC*cp|Bbk4QTgz@F&U5>GmWd7yCGX3"
    "0zvp?<&jqCS4786z!DaB#tCyDTxEE6Ncya;%pC84=A&bf0Vty$zm=>gp0GnNY!!gj8ihC{HHM#=}<TSkYS>HPpK$9p3UtNlTI1hvhBwJ{{k%7y?*"
    ")16X%fu!c>v+o#$-N_ajuaxRF`{qwkw30~Owj~7g=z9f|qz!q`=_%}^CJz5+W^8jkKTFRcdHoOQljv3"
)
PLACES: NDArray[np.int64] = (
    np.frombuffer(zlib.decompress(base64.b85decode(_PLACES)), dtype=np.int8).reshape(-1, 4).astype(np.int64)
)


def brief(
    gray: NDArray[np.uint8], pixels: NDArray[Any], angles: NDArray[Any] | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Strings of 512 bits: bit i is whether the first of places i is darker than the second.

    Args:
        gray: (H, W).
        pixels: (N, 2) x, y [px]; rounded.
        angles: (N,) [degrees] by which the places are turned before they are cut to whole pixels; None: upright.

    Returns:
        Descriptors (M, 64) of the M keypoints at least `BORDER` from the edge, and which (N,) those are.
    """
    height, width = gray.shape
    # OpenCV tests the keypoint itself and then rounds it, so that one just inside may reach out by a pixel: it is left.
    x, y = np.floor(np.asarray(pixels, dtype=np.float64).reshape(-1, 2) + 0.5).astype(np.int64).T
    inside = (x >= BORDER) & (x < width - BORDER) & (y >= BORDER) & (y < height - BORDER)
    if not inside.any():
        return np.empty((0, len(PLACES) // 8), dtype=np.uint8), inside
    sums = cv2.boxFilter(gray, cv2.CV_32F, (SMOOTHING, SMOOTHING), normalize=False)
    turned = angles is not None
    radians = np.asarray(angles if turned else np.zeros(len(x)), dtype=np.float32) * np.float32(np.pi / 180.0)
    return _compare(sums, x[inside], y[inside], np.cos(radians)[inside], np.sin(radians)[inside], turned), inside


@njit(cache=True)
def _compare(sums: Any, x: Any, y: Any, cos: Any, sin: Any, turned: bool) -> Any:  # pragma: no cover - compiled
    described = np.zeros((len(x), len(PLACES) // 8), dtype=np.uint8)
    for i in range(len(x)):
        for k in range(len(PLACES)):
            ya, xa, yb, xb = PLACES[k]
            if turned:  # and cut towards zero
                xa, ya = _turn(xa, ya, cos[i], sin[i])
                xb, yb = _turn(xb, yb, cos[i], sin[i])
            if sums[y[i] + ya, x[i] + xa] < sums[y[i] + yb, x[i] + xb]:
                described[i, k >> 3] |= 128 >> (k & 7)
    return described


@njit(cache=True)
def _turn(x: int, y: int, cos: float, sin: float) -> tuple[int, int]:  # pragma: no cover - compiled
    column, row = int(x * cos - y * sin), int(x * sin + y * cos)
    return min(max(column, -REACH), REACH), min(max(row, -REACH), REACH)
