"use strict";
// The counts of minimd/view/page.py, and what they mean: positions and bonds of a frame, in the cell of the user.
// `about` : low, width (frames × 3); lattice, edges, reduction (3 × 3); periodic (3); radii, colors of species; marked atoms.

const LEVELS = 65536;

class Motion {
  constructor(about, counts, species, bonds) {
    this.about = about;
    this.counts = counts; // three for each atom and frame
    this.species = species; // index of each atom's
    this.bonds = bonds; // two atoms each
    this.nAtoms = species.length;
    this.nFrames = about.steps.length;
  }

  /** Positions of a frame, x, y, z of each atom in turn, wrapped into the cell; into an array if one is given. */
  positions(frame, into = new Float32Array(3 * this.nAtoms)) {
    const { edges, reduction, periodic } = this.about, low = this.about.low[frame], width = this.about.width[frame];
    const end = 3 * this.nAtoms * (frame + 1);
    into.fill(0);
    for (let k = 0; k < 3; k++) {
      const [x, y, z] = edges[k], [p, q, r] = reduction.map((row) => row[k]);
      for (let at = end - 3 * this.nAtoms, i = 0; at < end; at += 3, i += 3) {
        const sum = p * this.counts[at] + q * this.counts[at + 1] + r * this.counts[at + 2];
        const part = low[k] + (width[k] * (periodic[k] ? sum & (LEVELS - 1) : sum)) / LEVELS;
        into[i] += part * x;
        into[i + 1] += part * y;
        into[i + 2] += part * z;
      }
    }
    return into;
  }

  /** r_j − r_i to the nearest image: 16 bits taken as a signed number. */
  separation(frame, i, j) {
    const { periodic, lattice } = this.about, width = this.about.width[frame], start = 3 * frame * this.nAtoms;
    const vector = [0, 0, 0];
    for (let k = 0; k < 3; k++) {
      const difference = this.counts[start + 3 * j + k] - this.counts[start + 3 * i + k];
      const part = (width[k] * (periodic[k] ? (difference << 16) >> 16 : difference)) / LEVELS;
      for (let d = 0; d < 3; d++) vector[d] += part * lattice[k][d];
    }
    return vector;
  }

  /** Ends of the two halves of each bond, each half beside its own atom: { start, end }, 6 numbers for each bond. */
  halves(frame, positions, start, end) {
    for (let b = 0; b < this.bonds.length; b += 2) {
      const ends = [this.bonds[b], this.bonds[b + 1]], vector = this.separation(frame, ends[0], ends[1]);
      for (let side = 0; side < 2; side++) {
        for (let d = 0; d < 3; d++) {
          const at = 3 * (b + side) + d, from = positions[3 * ends[side] + d];
          start[at] = from;
          end[at] = from + (side ? -0.5 : 0.5) * vector[d];
        }
      }
    }
  }
}
