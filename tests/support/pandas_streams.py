"""Data frames as pandas itself wrote them (``to_pickle``), by what they hold, its version and the protocol.

Of points: x, y, z, i = 0, 40 ... 160, t = 1557539956.5 + 0.01 n, d = 0 0 0 1 1. Of cuboids: uuid a b c, label Car
Pedestrian Bus, yaw 0.1 -0.2 0.3, stationary yes no yes, object_motion Parked None Moving, sensor_id -1 0 1.
"""

from base64 import b64decode

_STREAMS = {
    ("lidar", "1.0.3", 3): (
        "H4sICEW7CmsC/2xpZGFyXzMucGtsAHWUS3AURRjHZ5PsEgZRFFBeISEqdERGggETBXaTLMRkYMERZIEsY89sZ3tld7L/mR4lllvla6EoqZIq"
        "y6Mny7JKLS/ixYOx9IJllZccqKK4eLF8lI8TcAC1p2dSZXj0Yf79+Pqbr3/9ff16u9ugXpkGhjvtM2PKp3Wm56mge1UPWt8bSDXRRoppTdPs"
        "slzBwi1VTzDfo7XAqFOPVpgf6CO1affk/niko0O6SJMSMuSWfWV2igWGQwOm2x57xR6PZnQsurtZYtHZxGJS7JABqXh01wvrjZnYvh7WRJX6"
        "Pp3RbZ+5014g/NAVOpbEVrp0rVZxj6m1sHQ05eDeM7jPwjJipsxMC/cnhmUx05AEHii2yR8dGMRyUzNTZ7DCwkpithdTcvY1PFgoFCb+lU19"
        "zKzAQ87ZElYRtX4Kq5XOYI3SV7FWaRXrlAp0KS1jPRPodtSZPAkePYXwNDZY6OV3xuFTr8J0K/omUB5u4hHCe9Q9KSs8qvqBoL7ARlNTzgMx"
        "3cAmM50MWAPy1PJXfRYeYyVsJnwJV2Ae55LKFgtGRCVtpk/jCR6jmBrE1hhFv4Vt8yh24smFKOThBpyzoxc/9T/uuBpO5L7+pnvzS20kt+wD"
        "bcuXk7tyQ//k59768WDuRt/PA7X2fbk3z300cmXPX7O/vr9trrvyZ3bH23Pjn9nfzR69cPH6udpXs1N9lb93j13O/vHTJ0vTjW+z11o3zQv5"
        "a9nlv53//uSxX7Lnv3ivc9XG2ewPYe/hYX4lqy1o+VyshxI9kWhZak/XO9svDV/6MNbPxzYobf0e6+S7vUqxXWCHM4/nqQjPoIWhCE8qwvN0"
        "gqc6iGdiPDst7JJ4+O1gdkswRLtLS92ikEmVc+TlDBO+iMvcHyFcn49jNIojb2GPuqYW9vKVMv3GCF/N1/C1fB3vkon1rMNVPo1bmIhdmP9z"
        "sS9ysd9CQR2lhQPKxUG+ngo8l+y0LDzPmjhUzMiAthr9A0Y/DjfxQlyFVGYkjvCMWnWi4g9QLOEoaeIYUZMv01oobY5zo9gph/WKb0uzAJOu"
        "E1ZlwXqBHtSqriy3kmSXjuidsGCHTbxI+HE+xCd5SU5nogVqwQlZGAi4ccHYslBRLi5O3gP1hoGpsV1ngqpHYqqEiqoHKoQfgDdRDR3jPx8B"
        "Fjr/BAAA"
    ),
    ("lidar", "1.5.3", 4): (
        "H4sICEm7CmsC/2xpZGFyXzQucGtsAHVTTWgTQRTOptlaf2spagW12oOkiDmIfwV10zZa2tVUih6U1mU2O8mu3WyW3VnaiAX/ElscsNDp0ZOI"
        "oOLFevFgRC8VwUsPBelFEPEHf07Wg39vJi2mtT6Y+d7uvPfmvW/euxAZf1MVEkLrXOQYyI+lch6OpT2UxYwuTyCCjgh9jDVfZEMsSiNaNuMx"
        "uqXS3HII9hxk+7EsclAGez6jq9rsXKr/WPkb3On6OQ/NtnT/rwujtVrguFaq38aazn248TonyLr5cvRsYBMLeR7KQ1TNw6mc4xMvSBFuKAtD"
        "RpdBbGEyxtRQgbVLOrvKelhUlVRZlYvMrKWyQfIur4SG0/vZyHD5vIpKB1gymez6DSI2NUSYPtI+ede7HfkWdMUfP2nccTYcja+9Edr5sPdg"
        "vOVXYuryy+PxH81vd9tVR+OX6K22mcNfSu/Hd001Zj4re69Mdd7TnpVOTUx+p/ajUro58/VQxyvl0+s7q2X3qTJb+KlOJGaV+g+jz/tPv1NG"
        "H4zVNGwvKS+CppOt5owSWiCJeBlPzOGZOTQAt26+tme6dfpmGe93bBNY+FjG3utNAhmUQ2v0wAIaHeBb9m0rhQVRwI3EaVDDfDdXmmvMOk6f"
        "WT9PniTIa6Bhq4Iyc9NShEVD/xFpEfKEzCa4u7ry9iLrg/ZqWNhXBh7EfkxHPnTjCs3BA1on/wfJm/uoPK+LvjSgV9m/BVQXRPrdC178/KIX"
        "V3gB/HppkFEJ2kk6B8uCRWAZDHMKIw4fhGRQ5FS10I1LZeohJ8NT7eFYkZ7ZTWVhw+knyCNAPo34JOcyVeYKBkUSoTHfYMygWWECeVXz06hl"
        "MUGizD4IgwiBORtitFpL2ygj1A3ItnMDvmYELrwxIlizkY5hyIb9QI/9AbzOY+3vAwAA"
    ),
    ("lidar", "2.2.3", 5): (
        "H4sICEq7CmsC/2xpZGFyXzUucGtsAH1TTUzUQBRuly2ioKIkCAdBOZglxk38jSZqF1glUF0M0YMGbKa7s9tKt9u00wBGEv8WIU4iCQM3T8aY"
        "qPEiXDy4Ri8YEy8cSAwXL8af+HMSD/69mYW4EOIkM99r+96b771+77IyIYclsegmFzkp5EeTOQ9H0x7KYkbXxhFBx4U9zpqvsCEWoWE9m/EY"
        "bSh1txyCPQfZfjSLHJTBns9oVaudS/adLD5DOK1djNBty/D/hTC6UQ8c10r22Vg3eAx3rnGCrDsY1UV6sLFnJRmt1NNeLmsE6bRIGZmcKZKX"
        "Hnj3wt+DztjTZ407L4Qiserb0q7pniOxQ7/js9den4r9bH63zy47EbtK77bOH/ta+DCxZ7Yx80U9cH2246H+onB2auYHtZ8U0s2Zb0fb36if"
        "395fr7jP1YX8L20qvqDWfBx72XfuvTr2eLyibkdBfRU0nWkx51Vp2YrHinh6Ec8vYgpw29ab++da5u4U8VH7doH5T0XsudUkkFFFFA6YIoMu"
        "bzsNpQ+y0ZEbrJtFtDIqH2aJRKLzDyxxaBJhhqZoyjCjchsj4EYrjMCyieVAbxXftpI8jSaBk8yzaCF+mpXmhshkRPr/klcgMzfTkFXCx6xd"
        "hY3M2Zj1nIvZANeWl148zHpBRXXL5ZPCA9iPGsgH0a3THdyvd/B3wNvcTZUlW8gvBZIEMZXqIxtAtcjzEPStSvdwMuf4xAuShMdX0zVwk/jI"
        "u5BnbbLBiuxlrTwvKupa1uFLKzqsQk2jnLQ8AD2GO+SLsC3YBHaKYfhOww6fkkQwzIveS+tXq89DToYX2M2xpCiziyrCh/8vgjwCPGnYJzmX"
        "aQo3MBiySI35ATMI4oDx5L1YGlU9iwkSzemFNIgQGMIhRsv1tI0ywtyCbDvX7+upwAVRIIJ1GxkYJnDED4zoX4T1hJ8MBAAA"
    ),
    ("cuboids", "1.2.5", 4): (
        "H4sICEe7CmsC/2N1Ym9pZHNfNC5wa2wAjVTNT9RAFN9ud9d1kRgSCXAh0URdlDQQPXjQQFhj1MpKOEuaaTvsVPqxmQ9gE0j0AEIyN4ZE/U88"
        "efbsP+J/gG+mXVNIY5hD5/XNvPm9j997nxrnB82aWXJqiNIQMSfIKHa2KUqwkjdfIo5eGflMLXxWh6orG14yoErOl69HKcc0RTFzEpSiAaZM"
        "yVtrcRbsrOf/uXl3C+xnLxuGeB8zx0cM4Dpeive8N1oHBmRCNseyAQ7BGSWnU5EMR7l5ImIeIUrRCPA8ioMsZZyKgIOJbJqLSt4AOHPlTLm1"
        "I9WzfPVFbaqua7ntI0WmZTPko6GOUNbfP1OnJ/mpLa0D1e/3317AMh93hSv/VMfQECIKASFGPo6VtEdoD7xnHPEoSxEF0IkAkkaRJxiGi51h"
        "xiJ95uwrOYs4p5EvOMSd+R9xwL0k04dKTgXCz6KQOQynLKMegGDAlI1Ul6AvjsEzMinnqlJIUTrQOdzUeylvxOnLJrhGOYQvG4xnQwXBgYBB"
        "sMybGIIid8iMzg+ZG2en7trHiszL+valrDy/kpWazkpv6fs3vX6s5Puvn0/M+r2S0+tPsddW8629qsDsP5hRCZOsVSJeFKtePG0X+1hf/Nas"
        "Yq9GtMaI/nIJ8V4Vom3VrOpHbPPIXUMOC0gKHJNWAMzoIeiVzgYOMRAzQlBje01Ad7Q2EN0BavRlaz3bjdKBKbSpwyS5rcs2VZGcowKDPCSP"
        "9H2obcGJa9gskMVr2liFDemi6xnY/0DukwfkcRkGH0KwS87yU2c572IEZFWkI1u+ng9MgZXWt3ZRLPTJC9mGAePBIaSp7YsIWjwFscniKNBd"
        "Chxpu7aGFtodRV6Tc/LVbbidS9pNo7VBb5W0H0Bb6f67097sVcK0SsQRWDDTih4MC5iMehiNp6SXYI7MdNoCP3V7M6XD9rZjNDDiDIrjbI95"
        "oRhCFIhjz4wOpk6Y8J2//ELEsIcFAAA="
    ),
    ("cuboids", "2.2.3", 5): (
        "H4sICEq7CmsC/2N1Ym9pZHNfNS5wa2wAhVTPb9MwFE6atJRuAgbS2C67Ui4RaBcOiE0bQkC0Mu3MsOzEbUITp/gH2ySQ4LCxSb5hJsGdP4IT"
        "Z878I/wH49lpR4uGeFLi51/vfd9nP79rfvoaes70wgizFIsoqTiN+hyX1OjLD7HEj5z/0dx+b96arg5ROeBGr0wvz5mknOFCRCVmeEC5MHp+"
        "o6iS4Vbdh+1dvTjegoqciD97jL6KFBvlybCgiNhNsFrfYKocHUTIxQef8jwxeg71eVUS1e/XMU+DGr3ne77RTbcH2lQejCxk3SB3zcnxB7Nj"
        "unGg/Tem1+s9PQNzv9iThsR+HBwZ7W8aCct0m6i8kDkDWE1R5IkNEwdxGPs2Styw/2wuu9I9vTNO/eWztW9rdfvj+6qzn2v17K9x663XTXvd"
        "ZNd1o39vGtf9i3A1LK5s2aLKVqDXjoN/QTgbW2PcD/4a985Vqs1ByKcgZLf+CyCMO7MA9OL0EZUKVMOcY9B/HnGaVExIrhIJ+mXX9CU4eTcJ"
        "anqHZtMnpk4N6rs0AOjZNKDFWUBrAOhkFy6Rj+GsCHxwG4JNDDexs01TCrlyzGBoQ8HJtbYxH9LU9HRrq3qds4GhsN8qtuTN2kSR1rkyq3Fw"
        "OGZdM5XG5l2ave8p3aciIlhAlXQQo3voiR2zZJ/r5sR39ZJCDZnsQbZuiWcbE9pt6Dx2lEKl8hSuW4EJLYDCAd6DoEJimVcMcxB0LoES5Bgp"
        "AaR0Z1SJ3M5F+0YvYQnUiZIApyIvaSJRWdlJoxcSRao8FZGgTFQcQRIrgw6ZLeieOrLH+EIvX8SMYzaw1HZsO0Une9WDupCYSzhHHQpZjaA8"
        "rEPB8V1Man/wTkARwhNi6U+eE1RSiZ0eu8DXIhcQVLdQv8AD597ERVHtCZSqERQflhQ5VYQ5FopEvwERJe3ksAQAAA=="
    ),
    ("lidar", "1.3.5", 4): (
        "H4sICEi7CmsC/2xpZGFyXzQucGtsAHVTSWgUQRSdnkzHxA0XNAkuiUFlRnEOoqKg9iSZGJLWUYIe1MSmZrpmuk0vQ3c1ScSA28QECwykcvQk"
        "Iqh4MV48OKKXiOAlh4Dk4kVccDkZD26/ahKyGAuqX3XX71+v3n//UmRkWyQkBl2dR46O/HjG9XA86yEbM1qZRAQdEethFrvM+liURjQ75zG6"
        "eW646RDsOcjy4zZyUA57PqPLGy0303Ws9A6/08ps4GSI61qwuSSPPGIii3/fuHimNP8dQisd3K2JFwgusHYWNVbG+hiNOLppMzXspwhL03VO"
        "YOd7SznswILcnod6gYXm4Yzr+MQLMoSfJotAYABnipBhpoYKrElKs+s8uSqpsir3M6OKyjrpzfOb03B2PxscKO2XUekgS6VSbX9giIcaAgaD"
        "TWP3vbuR70Fb4umz2p3nw9HEqluhXY87DiUO/E6OX319IvEz9m6PVXY0cYXeaZxs/lr8MLJ7vDb3Rdl3bbz1gfaieHp07Ae1nhSzsdy3wy1v"
        "lM9v762Q88+VqcIvdTQ5paz9OPSy68x7ZejRcEX19qLyKqg/1WBMKqF5I5ko4clpPDeNOmDdpht7JxombpfwYcsWgYVPJey4WS+QcUEr0oEJ"
        "MjpQAdm3zAwWQoE2EpehH6axzFg5Ww9jzXQpjPVGDVfU2DCjpyT0rKNhc46KxtbFNIyG/jOkBcg5GjuATvksoX7WCf6snm8nHfdgMBPywc5L"
        "Ne6lVv4NbmM0UXlmLYytg9nZv/TLC4L88XkWuLjAAgqnz4+XehiVwF/SBZgmTAJTZ5hrGnF4J6UCoV4zrVmMqYecHKfaznEOPeMslUUMrweB"
        "7oFq0IhP3DxTZb7AsJBEaswf0KfgXmgffquZdtZsTJC4ZiekQYRAo0IrlWtZC+XEsgpZltvta3qQh6IjgjULpTG07IAfpON/AZm/i8YwBAAA"
    ),
    ("cuboids", "3.0.0", 5): (
        "H4sICEy7CmsC/2N1Ym9pZHNfNS5wa2wArVTPT9RAFG633WVZ/BFCRBIJejFZLxsNFw8mIBCNNKwEz2QybWe3lXbazEyFTTTqAYRkbo4kevLf"
        "4OTZs/+I3rzhm2kXdonGmDiHdtr33nzf996b96b+4aRumSUbOaYh5kpOrmGBHzGcEvVe3XmrXqm2dFHaZ0oulD6dIGOkE1NBGMUJ76SY4j5h"
        "EHtpJcmCnY3yG8LbcrYKQUns8/MYJa+iguZxsJMQ5Osg8JYzY86YMTwAz3mE8sHeuXt37aG2rOBgh4Q67HIVNgyYeiZYTPvGC+zrNxs/3O47"
        "taUia2hbE4Nc6wPZAxFlVD1+/bNMxAH4yVlapPmgg4zQtEhEbM4GgYiRIKNcsCIQOr5uPJWcAAYVnmftq1XbVxqx7dmes6+ieVkPh5C1p/fV"
        "0WFpdaT9UnW73fVTWObhLQnlH21D6mysJBwj7UAR+HegfNn0ixjIUBBZ50kcEAMHGLY+zqsZkVPRlWh6RPS1aHZMXXQjWtAco1ujDNsG01nF"
        "UOfWJgkJaIwxVdJZKfiQQLQI3rX/htbYxEzX8CxANjayF1CeEbyGNzGOJ2dGiwN7wuIAio56LEv9otcrO+/YKY+0bMtW0W1Z8++dZz26M55z"
        "C+A0swPI9qoSGmfRczz3gtLt9vHd6tRPH/U6WSrfX78smvVtqbR+r97WcvlqLhsKvbHCP1C/IVHTJKKwolDzmp7zJwqn1apV386F/9ZZAspl"
        "KMQjFKLsrwRcrzVKQChdtrnxMRCSPcI7PuYEOgdRsoue6H9QBLhv9eHejJEQRov654ZpnjWMWxRxCL2fYJ8k0JoDvAuYXGARZxQzuIdTAQwu"
        "hlHBoa9kK894rG2dPSXnsICW9gsBbDP/OQkESjNtVHI6KPwsDnmHE8ozhgBkeOVcqidhtzDUDkFRawvTPhmRFX3uwm0UmAm4i9LlIssV1Bc2"
        "BDa2iSRmrLgIZgBMWJ2GnpmwchKlRGCTl20QpilyOFQ2UC/BfbO9jpMk2+UoLHK48lgQZORzdcgLv/MLBe6P3MQFAAA="
    ),
}


def pandas_stream(kind: str, version: str, protocol: int) -> bytes:
    """One of them, packed by gzip as pandas packs it."""
    return b64decode(_STREAMS[kind, version, protocol])
