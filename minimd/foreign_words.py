"""Words of the field that are no names of minimd, and what to use here: for the AttributeError of md.Word.

docs/where-is.md has the same words and answers, and a test compares them.
"""

from collections.abc import Callable

# words; the answer, and its page in docs/
WORDS = """
NVT NoseHoover NoseHooverChain NoseHooverChainNVT Bussi CSVR VRescale Thermostat tcoupl
    md.StochasticVelocityRescaling, or md.LangevinBAOAB; minimd.ase has NoseHooverChainNVT and Bussi | temperature
HMC GHMC GHMCIntegrator Hamiltonian MonteCarlo MC Metropolis
    md.HybridMonteCarlo, trajectories that are accepted or taken back; no other moves | hybrid-monte-carlo
Langevin Brownian Overdamped LangevinIntegrator LangevinMiddleIntegrator BrownianIntegrator BAOAB sd bd
    md.LangevinBAOAB, or md.BrownianDynamics for overdamped motion | temperature
Berendsen NVTBerendsen VelocityRescaling
    md.StochasticVelocityRescaling, which samples the ensemble; sim.equilibrate only rescales | temperature
Andersen AndersenThermostat DPD
    in minimd.ase for scripts of ASE; else a thermostat of your own has ten lines | own-parts
NPT NPH Barostat ParrinelloRahman MTK BerendsenBarostat MonteCarloBarostat CRescale
    md.StochasticCellRescaling, as barostat= of a simulation with a thermostat | pressure
NVE Verlet VerletIntegrator LeapFrog Integrator MD Dynamics CustomIntegrator
    md.VelocityVerlet, or another of md.integrators.METHODS | timestep
Anneal Annealing Quench Heating
    temperature=md.Ramp(start, stop, steps) of a bath, also pressure=; or stages with sim.method = ... | temperature
Reverse Reversible TimeReversal reversibility backwards
    precision="fixed-point", then sim.run_back, or sim.velocities *= -1; not with rigid bonds | fixed-point
Minimizer FIRE BFGS LBFGS ConjugateGradient SteepestDescent Relax Optimizer minimizeEnergy
    sim.minimize(), or md.minimize | blow-up
KobAndersen Kob BinaryMixture Mixture
    md.LennardJones of species, with mixing= or pairs= | bonds
Neon Argon Krypton Xenon NobleGas NobleGases LJParameters
    md.LennardJones(epsilon, sigma, cutoff); the page has ε and σ of Ne, Ar, Kr and Xe | forces
LJ LennardJonesCut WCA
    md.LennardJones; WCA has cutoff=2 ** (1 / 6) | forces
SoftSphere SoftSpheres CosineRepulsion PushOff
    md.SoftRepulsion(height, cutoff), the cosine of pair_style soft; powers of r by md.PairPotential | forces
MiePotential MieCut NMPotential
    md.Mie(epsilon, sigma, n, m, cutoff) | forces
Buckingham Yukawa SoftCore Gaussian BornMayer Custom CustomNonbondedForce PairLaw
    md.PairPotential(law, parameters, cutoff) with a function of r² | own-laws
Table TabulatedPotential PairTable TableFile
    md.Tabulated(r, u); of a file for LAMMPS: md.Tabulated.from_file(file, keyword) | own-laws
Morse
    md.MorseBond | forces
QuarticBondPotential ClassTwoBond Class2
    md.QuarticBond(k2, k3, k4, length) | forces
Ewald PME PPPM Electrostatics ReactionField Wolf Charges
    md.Coulomb(cutoff, accuracy) | water
Madelung MadelungConstant LatticeEnergy
    md.evaluate(ions, md.Coulomb(cutoff, accuracy)).potential_energy | charges
PerAtomVirial AtomicStress Virial Virials
    md.evaluate(sim.system, sim.potentials).virial, or .virials of atoms; the pressure is sim.pressure | pressure
EAM Metal SuttonChen Gupta FinnisSinclair
    md.EmbeddedAtom; of a file for LAMMPS: md.EmbeddedAtom.from_file(file) | metals
Nanocluster Nanoparticle Lindemann LindemannIndex
    an open cell and md.EmbeddedAtom; Lindemann's index is one line of numpy, in examples/metal.py | metals
Melting MeltingPoint Freezing Superheating Coexistence TwoPhase
    density and U against T, md.observers.BondOrder("q6"); one phase alone melts too late | temperature
MTS MultipleTimestep run_style rRESPA
    md.RESPA, md.LangevinRESPA: bonded forces in inner steps, all others around them | timestep
RK4 RungeKutta4
    not here for atoms; Runge-Kutta methods are in md.integrators, for small systems | small-systems
Tersoff StillingerWeber MEAM SNAP MACE MLPotential sw
    not here: pass a calculator of ASE as the potential | limits
Umbrella UmbrellaSampling WHAM MBAR Histogram PMF PotentialOfMeanForce
    md.Restraint, or md.HarmonicBond on a distance; then md.free_energy.umbrella(series, centers, k, kT) | free-energy
Bias Colvar Plumed Metadynamics
    md.Restraint, or md.HarmonicBond on a distance; no bias that grows during a run | free-energy
Jarzynski BAR BennettAcceptanceRatio Crooks
    md.free_energy.jarzynski(works, kT), md.free_energy.bar(forward, backward, kT) | free-energy
SMD Pull Pulling SteeredMD
    md.SteeredSpring, and record.work | forces
ElectricField ExternalField External Efield CustomExternalForce gravity
    md.ConstantForce(charges[:, None] * E), or md.Field(law, parameters) | forces
SPC SPCE TIP3P OPC OPC3 Water TIP4P TIP4PEw TIP4P2005 TIP5P
    md.water("TIP4P/2005"), "SPC/E", "OPC", ...; five sites by md.Sites | water
VirtualSite MasslessSite LonePair TwoParticleAverageSite ThreeParticleAverageSite OutOfPlaneSite
    md.System(..., sites=md.Sites(atoms, parents, weights)) | water
Ions NaCl Salt Solvate AddIons
    md.water("SPC/E", 512, ions={"Na": 5, "Cl": 5}); other solutes by md.from_openmm | water
Chain Polymer Chains RandomWalk Rouse
    md.lattice.chains, and sim.minimize() for walks that overlap | recipes
Packmol Packing InsertMolecules RandomPlacement
    md.lattice.packing([(molecule, n), ...], edges, distance) | recipes
InternalDistances MSID EquilibratedMelt
    numpy, since positions are never wrapped: ten lines | recipes
RadiusOfGyration Gyration EndToEnd Asphericity
    md.observers.ChainShape | observers
SHAKE RATTLE SETTLE LINCS Constraints FixBondLengths RigidBonds HBonds AllBonds addConstraint
    md.DistanceConstraints(pairs) | bonds
FixAtoms Freeze SetForce freezegrps
    md.FixedAtoms(atoms) | bonds
RigidBody RigidMolecule Rigid
    md.DistanceConstraints between the atoms of a molecule | bonds
RDF GofR PairCorrelation
    md.observers.RadialDistribution | observers
MSD Diffusion
    md.observers.MeanSquareDisplacement | observers
Spectrum PowerSpectrum VibrationalSpectrum VDOS DensityOfStates NormalModes Phonons Hessian DynamicalMatrix FFT
    velocities that a function keeps, and numpy's FFT; VelocityAutocorrelation has uneven lags | recipes
VACF VelocityAutoCorrelation
    md.observers.VelocityAutocorrelation | observers
Shear ShearFlow Couette Poiseuille Flow FlowProfile LeesEdwards SLLOD NEMD SineForce
    a force A cos kz of a Term, or layers that md.SteeredSpring moves; md.observers.Profile has the flow | recipes
GreenKubo ShearViscosity EinsteinHelfand
    md.observers.Viscosity | observers
Conductivity ElectricalConductivity IonicConductivity NernstEinstein
    md.observers.Conductivity | observers
Deform Strain ChangeBox
    not during a run; between two, sim.system.cell = md.Cell(vectors, pbc) | where-is
HeatFlux ThermalConductivity MullerPlathe
    md.observers.ThermalConductivity; or exchange velocities, in an observer | observers
Dielectric DielectricConstant Dipole Dipoles Permittivity
    md.observers.DielectricConstant | observers
OrderParameter orientorder Hexatic Psi6 Steinhardt CNA Q6
    md.observers.BondOrder, by the package freud; without it md.neighbor_list and numpy | observers
HydrogenBonds HydrogenBondAnalysis hbond Tetrahedral TetrahedralOrder
    MDAnalysis with universe(file) of minimd.mdanalysis; tetrahedra by md.neighbor_list and numpy | recipes
SurfaceTension Interface
    md.observers.SurfaceTension | observers
PressureTensor Stress StressTensor
    sim.stress; in the record: sim.extra_observables = ("stress",) | pressure
ElasticConstants Elastic BulkModulus YoungModulus ShearModulus
    stress against strain, by md.evaluate; for metals examples/metal.py | recipes
LatticeConstant LatticeParameter CellRelaxation RelaxCell
    the minimum of md.evaluate(system, potentials).potential_energy over the cell | recipes
HeatCapacity SpecificHeat Cv Cp Compressibility IsothermalCompressibility ThermalExpansion
    md.observers.Fluctuations; the bulk modulus of a liquid is 1/κ_T | observers
MagneticField Magnetic Lorentz LorentzForce Boris Cyclotron
    one particle: md.integrators.SecondOrder(f(q, v)); atoms: a splitting of your own that turns velocities | own-parts
Euler SymplecticEuler SemiImplicitEuler
    md.integrators.SE1, symplectic Euler; explicit Euler is not here: md.grade judges one of yours | small-systems
Pendulum DoublePendulum
    md.FixedAtoms, md.DistanceConstraints and md.Gravity; or md.integrators.Holonomic | small-systems
Movie Film Animation Snapshot Render Ovito VMD
    md.view(file); a picture or a film of the box by ase.io.write | view
CIF POSCAR VASP PDB SaveAs
    ase.io.write(file, system.to_ase()); LAMMPS data: sim.system.write("melt.data") | formats
GRO editconf
    ase.io.write("last.gro", sim.system.to_ase()); trajectories by md.to_gromacs(run, file) | formats
Barometric Sedimentation Atmosphere
    md.Gravity, md.Wall and md.observers.Profile | recipes
Density MassDensity rho
    print(sim.system); of a record, system.masses.sum() / record.volume / md.units.GRAM_PER_CM3 | units
DensityProfile TemperatureProfile Chunk
    md.observers.Profile | observers
PressureProfile IrvingKirkwood
    md.observers.PressureProfile | observers
ScatteringFunction IntermediateScattering FsQT Overlap Chi4
    md.observers.SelfScattering; overlaps are not here | observers
TwoDimensional Dimension Enforce2D Disks
    md.System(..., planar=True) | bonds
Trajectory Dump LAMMPSDump Lammpstrj DCD XTC H5MD XYZ Reporter StateDataReporter DCDReporter Logger
    sim.run(n, every=..., trajectory="run.h5md") | formats
Restart Checkpoint Load Resume read_restart CheckpointReporter loadCheckpoint
    md.Simulation.resume(file, potentials) | files
Atoms Topology Box Particles Molecule read read_lammps_data from_file read_data read_dump
    md.System, or system_from_file of minimd.ase | formats
CMAP CMAPTorsionForce Crossterms
    md.DihedralMap; md.from_openmm makes it | forces
NBFIX
    md.LennardJones(..., pairs={...}); md.from_openmm makes them | forces
ForceField AmberPrmtopFile GromacsTopFile CharmmPsfFile ITP
    md.from_openmm; types and parameters are given as numbers | forces
Slurm sbatch Cluster Queue maxh WallTime
    minimd run scene.toml --max-seconds S ends with exit code 4, minimd resume goes on | files
Run Production Context nsteps
    md.Simulation(system, potentials, method), then sim.run(n) | first-steps
Velocities MaxwellBoltzmann MaxwellBoltzmannDistribution set_velocities Stationary
    sim.set_temperature(T, seed) | first-steps
Join Concatenate Merge
    files by MDAnalysis.Universe(first, [first, second]); runs by md.ensemble | recipes
Compare CompareAverages Significance TTest zscore
    z = (a − b)/√(σ_a² + σ_b²) of two means with errors | recipes
Scan Sweep Replica
    md.ensemble makes many runs | ensembles
ReplicaExchange ParallelTempering REMD Tempering temper
    md.exchange: replicas at several temperatures, which neighbors exchange | ensembles
GCMC Alchemical
    not here; md.free_energy has those of distances, and of energies that you compute | limits
GPU CUDA OpenCL Kokkos MPI Platform mpirun
    not here: threads= of md.Simulation uses the cores of one machine | limits
Tdamp Pdamp damp tau_t tau_p ref_t ref_p
    relaxation_time=, temperature=, pressure=, compressibility= of bath and barostat; friction= is 1/damp | pressure
pcoupl NPTBerendsen MTKNPT FrechetCellFilter UnitCellFilter
    md.StochasticCellRescaling, or ASE's own classes with minimd.ase.Calculator | pressure
buck CustomBondForce CustomTorsionForce
    md.PairPotential, md.BondPotential or md.DihedralPotential with functions | own-laws
coulombtype rcoulomb fourierspacing kspace_style ewaldErrorTolerance NonbondedForce
    md.Coulomb(cutoff, accuracy): rcoulomb is its cutoff, the mesh follows from the accuracy | charges
MDLogger attach nstxout
    sim.run(n, every=..., trajectory="run.h5md", observers=[function]) | own-parts
velocity gen_vel gen_temp gen_seed setVelocitiesToTemperature CMMotionRemover
    sim.set_temperature(T, seed); sim.velocities -= sim.drift | temperature
AveTime TimeAverage RunningAverage Average BlockAverage Autocorrelation Error ErrorBar StatisticalInefficiency
    record = sim.run(n, every=10), then md.mean_and_error(record.pressure) | notebook
thermo thermo_style getState get_potential_energy get_stress
    record = sim.run(n, every=100); now sim.potential_energy, sim.stress; without a run md.evaluate | notebook
EnergyTerms EnergyComponents evdwl ecoul ebond
    each potential alone: md.evaluate(sim.system, potential).potential_energy | recipes
Heat EHEX TwoBaths ThermostatGroup tc_grps
    a bath for a part of the atoms is a class of twenty lines | own-parts
pair_style pair_modify special_bonds bond_style angle_style rvdw DispCorr TailCorrection LongRangeCorrection
    a potential for each: md.LennardJones(..., cutoff, tail_correction=True), md.HarmonicBond, ... | forces
create_atoms
    md.lattice.crystal | bonds
write_data
    sim.system.write("melt.data") | formats
neighbor neigh_modify NeighborSkin
    nothing to set: no pair is ever missed | lists
reset_timestep
    sim.step = 0; sim.time = 0.0 | first-steps
set_initial_charges
    md.System(..., charges=q) | water
FixCom
    taken over from atoms of ASE; else sim.velocities -= sim.drift | ase
RMSD RMSF
    MDAnalysis.analysis.rms, on minimd.mdanalysis.universe(file) | formats
rerun
    observers of a file: minimd.mdanalysis | formats
GBSAOBCForce AmoebaMultipoleForce CustomGBForce
    not here: run these with OpenMM | limits
universe radial_distribution mean_square_displacement diffusion_coefficient Turn
    minimd.mdanalysis.universe, and others of minimd.mdanalysis, for files of runs | formats
"""


def entries() -> list[tuple[list[str], str, str]]:
    """Words, their answer, and its page."""
    lines = WORDS.strip().splitlines()
    found = []
    for words, rest in zip(lines[::2], lines[1::2], strict=True):
        answer, page = rest.strip().split(" | ")
        found.append((words.split(), answer, page))
    return found


def plain(word: str) -> str:
    """A word in lower case, without underscores."""
    return word.lower().replace("_", "")


def answer_to(name: str, spelling: Callable[[str], str] = plain) -> str:
    """What to use in place of a name, with the page that tells it; empty if the word is not known.
    spelling : of words that count as the same; str for the word as it is written."""
    for words, answer, page in entries():
        if spelling(name) in map(spelling, words):
            return f"; here: {answer} (docs/{page}.md)"
    return ""
