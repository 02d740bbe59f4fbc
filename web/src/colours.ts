// Colours that a colour-blind reader tells apart: viridis, cividis and inferno for scalars, Okabe and Ito's eight for classes.

type Stop = readonly [number, number, number];

const VIRIDIS: Stop[] = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];
const CIVIDIS: Stop[] = [[0, 34, 78], [35, 62, 108], [71, 81, 107], [97, 100, 112], [124, 123, 120], [150, 147, 117], [181, 170, 105], [217, 200, 78], [254, 232, 56]];
const INFERNO: Stop[] = [[10, 8, 30], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51], [249, 140, 10], [249, 201, 50], [252, 255, 164]];
const SIGNED: Stop[] = [[64, 150, 255], [96, 168, 245], [130, 184, 232], [170, 198, 215], [215, 215, 215], [225, 190, 150], [235, 165, 95], [240, 135, 50], [245, 105, 20]];

export const SCALES = { viridis: VIRIDIS, cividis: CIVIDIS, inferno: INFERNO, signed: SIGNED } as const;
export type Scale = keyof typeof SCALES;
export const SCALE_ROWS: Scale[] = ["viridis", "cividis", "inferno", "signed"];

export function sample(scale: Scale, t: number): Stop {
  const stops = SCALES[scale];
  const place = Math.min(1, Math.max(0, t)) * (stops.length - 1);
  const low = Math.min(Math.floor(place), stops.length - 2);
  const f = place - low;
  const a = stops[low]!;
  const b = stops[low + 1]!;
  return [a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2])];
}

/** 256 x 4 RGBA bytes, one row a scale, for one small texture. */
export function table(): Uint8Array<ArrayBuffer> {
  const out = new Uint8Array(256 * SCALE_ROWS.length * 4);
  SCALE_ROWS.forEach((scale, row) => {
    for (let i = 0; i < 256; i += 1) {
      const [r, g, b] = sample(scale, i / 255);
      out.set([r, g, b, 255], (row * 256 + i) * 4);
    }
  });
  return out;
}

export const PATTERN_COLOURS = ["#56B4E9", "#E69F00", "#00C08B", "#E08FBB", "#F0E442", "#D55E00"];
