"""Arms drawn at random, their descriptions, and their torques by the Newton-Euler recursion on whole recordings."""

import math

import numpy

GRAVITY_M_S2 = 9.81

# a_m, alpha_deg, d_m, theta_offset_deg and type of each joint (modified Denavit-Hartenberg), for an arm of 1 m reach
SHAPES = {
    "six heavy": [(0, 0, .40, 0, "r"), (.15, -90, 0, -90, "r"), (.45, 0, 0, 0, "r"), (.08, -90, .45, 0, "r"),
                  (0, 90, 0, 0, "r"), (0, -90, .09, 0, "r")],
    "six light": [(0, 0, .16, 0, "r"), (0, 90, 0, 0, "r"), (-.43, 0, 0, 0, "r"), (-.39, 0, .13, 0, "r"),
                  (0, 90, .10, 0, "r"), (0, -90, .10, 0, "r")],
    "seven": [(0, 0, .34, 0, "r"), (0, -90, 0, 0, "r"), (0, 90, .40, 0, "r"), (0, 90, 0, 0, "r"), (0, -90, .40, 0, "r"),
              (0, -90, 0, 0, "r"), (0, 90, .12, 0, "r")],
    "five": [(0, 0, .20, 0, "r"), (.03, -90, 0, 0, "r"), (.25, 0, 0, 0, "r"), (.22, 0, 0, 0, "r"), (0, 90, .1, 0, "r")],
    "four": [(0, 0, .25, 0, "r"), (0, 90, 0, 0, "r"), (.35, 0, 0, 0, "r"), (.30, 0, 0, 0, "r")],
    "scara": [(0, 0, .3, 0, "r"), (.35, 0, 0, 0, "r"), (.30, 0, 0, 0, "p"), (0, 180, 0, 0, "r")],
}
HEAVY = {"six heavy": 1.0, "six light": .12, "seven": .15, "five": .05, "four": .1, "scara": .1}


def turn_x(angle):
    c, s = math.cos(angle), math.sin(angle)
    return numpy.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turn_z(angles):
    c, s = numpy.cos(angles), numpy.sin(angles)
    zero, one = numpy.zeros_like(c), numpy.ones_like(c)
    return numpy.stack([numpy.stack([c, -s, zero], -1), numpy.stack([s, c, zero], -1), numpy.stack([zero, zero, one], -1)], -2)


class Arm:
    """Geometry, bodies, motors and friction of one specimen."""

    def __init__(self, random, shape):
        self.shape = shape
        self.rows = [list(row) for row in SHAPES[shape]]
        self.n = len(self.rows)
        reach = random.uniform(.7, 1.3) * (2.2 if shape == "six heavy" else 1)
        for row in self.rows:
            row[0] *= reach * random.uniform(.9, 1.1)
            row[2] *= reach * random.uniform(.9, 1.1)
        total = 900 * HEAVY[shape] * random.uniform(.5, 1.3)
        share = numpy.array([.62 ** k for k in range(self.n)])
        self.mass = total * share / share.sum() * random.uniform(.8, 1.2, self.n)
        self.centre, self.inertia = [], []
        for k in range(self.n):
            ahead = self.rows[k + 1] if k + 1 < self.n else (.05 * reach, 0, .05 * reach, 0, "r")
            size = max(.08 * reach, math.hypot(ahead[0], ahead[2]))
            along = numpy.array([ahead[0], -ahead[2] * math.sin(math.radians(ahead[1])), ahead[2] * math.cos(math.radians(ahead[1]))])
            self.centre.append(.4 * along + random.normal(0, .06 * size, 3))
            # three principal moments of a box are always those of a body
            sides = size * random.uniform(.25, .7, 3)
            moments = self.mass[k] / 12 * (sides.dot(sides) - sides ** 2)
            axes, _ = numpy.linalg.qr(random.normal(size=(3, 3)))
            self.inertia.append(axes @ numpy.diag(moments) @ axes.T)
        self.scale = self.torque_scale()
        effective = numpy.array([self.mass[k:].sum() * (.15 * reach) ** 2 for k in range(self.n)])
        effective = numpy.where([row[4] == "p" for row in self.rows], self.mass, effective)
        self.rotor = effective * random.uniform(.2, 1.2, self.n)
        self.coulomb = self.scale * random.uniform(.06, .25, self.n)
        self.viscous = self.scale * random.uniform(.05, .25, self.n) / self.top_speed()
        self.law = random.choice(["plain", "stribeck", "power", "smooth", "load"])

    def top_speed(self):
        return numpy.array([1.0 if row[4] == "p" else 2.0 for row in self.rows])

    def limits(self):
        return [(.0, .35) if row[4] == "p" else (-2.9, 2.9) for row in self.rows]

    def torque_scale(self):
        """Size of the torque of each joint over random states, Nm (N)."""
        random = numpy.random.default_rng(5)
        q = random.uniform(-1, 1, (self.n, 200))
        v, a = random.uniform(-1.5, 1.5, (self.n, 200)), random.uniform(-4, 4, (self.n, 200))
        self.rotor = numpy.zeros(self.n)
        size = numpy.sqrt((self.rigid(q, v, a, numpy.array([0, 0, -GRAVITY_M_S2])) ** 2).mean(1))
        return numpy.maximum(size, .02 * size.max())

    def rigid(self, q, v, a, gravity):
        """Torque of links and rotors, `[n, rows]`; gravity in the base frame, m/s^2."""
        rows = q.shape[1]
        z = numpy.array([0, 0, 1.0])
        spin, turning = numpy.zeros((rows, 3)), numpy.zeros((rows, 3))
        pushed = numpy.tile(-gravity, (rows, 1))
        frames, places, forces, moments = [], [], [], []
        for k, (a_m, alpha, d_m, offset, kind) in enumerate(self.rows):
            slides = kind == "p"
            alpha = math.radians(alpha)
            angle = math.radians(offset) + (0 if slides else q[k])
            frame = turn_x(alpha) @ turn_z(angle * numpy.ones(rows))
            depth = d_m + (q[k] if slides else 0) * numpy.ones(rows)
            place = numpy.stack([a_m * numpy.ones(rows), -math.sin(alpha) * depth, math.cos(alpha) * depth], -1)
            back = numpy.swapaxes(frame, 1, 2)
            pushed = pushed + numpy.cross(turning, place) + numpy.cross(spin, numpy.cross(spin, place))
            pushed = numpy.einsum("tij,tj->ti", back, pushed)
            spin = numpy.einsum("tij,tj->ti", back, spin)
            turning = numpy.einsum("tij,tj->ti", back, turning)
            if slides:
                pushed = pushed + 2 * v[k][:, None] * numpy.cross(spin, z) + a[k][:, None] * z
            else:
                turning = turning + v[k][:, None] * numpy.cross(spin, z) + a[k][:, None] * z
                spin = spin + v[k][:, None] * z
            centre = self.centre[k]
            felt = pushed + numpy.cross(turning, centre) + numpy.cross(spin, numpy.cross(spin, centre))
            forces.append(self.mass[k] * felt)
            moments.append(turning @ self.inertia[k] + numpy.cross(spin, spin @ self.inertia[k]))
            frames.append(frame)
            places.append(place)
        torque = numpy.zeros_like(q)
        force, moment = numpy.zeros((rows, 3)), numpy.zeros((rows, 3))
        for k in reversed(range(self.n)):
            moment = moment + moments[k] + numpy.cross(self.centre[k], forces[k])
            force = force + forces[k]
            torque[k] = (force if self.rows[k][4] == "p" else moment)[:, 2]
            force = numpy.einsum("tij,tj->ti", frames[k], force)
            moment = numpy.einsum("tij,tj->ti", frames[k], moment) + numpy.cross(places[k], force)
        return torque + self.rotor[:, None] * a

    def columns(self, q, v, a, gravity, geometry=None):
        """Regressor of the rigid torques `[n, rows, 10 n]`: m, m c and the inertia about the joint's origin of each link."""
        geometry, rows = geometry or self.rows, q.shape[1]
        spin, turning = numpy.zeros((rows, 3)), numpy.zeros((rows, 3))
        pushed, z = numpy.tile(-gravity, (rows, 1)), numpy.array([0, 0, 1.0])
        frames, places, wrenches = [], [], []
        for k, (a_m, alpha, d_m, offset, kind) in enumerate(geometry):
            slides, alpha = kind == "p", math.radians(alpha)
            frame = turn_x(alpha) @ turn_z(math.radians(offset) + (0 if slides else q[k]) * numpy.ones(rows))
            depth = d_m + (q[k] if slides else 0) * numpy.ones(rows)
            place = numpy.stack([a_m * numpy.ones(rows), -math.sin(alpha) * depth, math.cos(alpha) * depth], -1)
            pushed = pushed + numpy.cross(turning, place) + numpy.cross(spin, numpy.cross(spin, place))
            pushed, spin, turning = (numpy.einsum("tji,tj->ti", frame, x) for x in (pushed, spin, turning))
            if slides:
                pushed = pushed + 2 * v[k][:, None] * numpy.cross(spin, z) + a[k][:, None] * z
            else:
                turning = turning + v[k][:, None] * numpy.cross(spin, z) + a[k][:, None] * z
                spin = spin + v[k][:, None] * z
            force, moment = numpy.zeros((rows, 10, 3)), numpy.zeros((rows, 10, 3))
            force[:, 0] = pushed
            for axis, unit in enumerate(numpy.eye(3)):
                force[:, 1 + axis] = numpy.cross(turning, unit) + numpy.cross(spin, numpy.cross(spin, unit))
                moment[:, 1 + axis] = numpy.cross(unit, pushed)
            for column, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
                entry = numpy.zeros((3, 3))
                entry[i, j] = entry[j, i] = 1
                moment[:, 4 + column] = turning @ entry + numpy.cross(spin, spin @ entry)
            frames.append(frame)
            places.append(place)
            wrenches.append((force, moment))
        out = numpy.zeros((self.n, rows, 10 * self.n))
        for link in range(self.n):
            force, moment = wrenches[link]
            for k in range(link, -1, -1):
                out[k, :, 10 * link:10 * link + 10] = (force if geometry[k][4] == "p" else moment)[:, :, 2]
                force = numpy.einsum("tij,tcj->tci", frames[k], force)
                moment = numpy.einsum("tij,tcj->tci", frames[k], moment) + numpy.cross(places[k][:, None], force)
        return out

    def parameters(self):
        """What [`Arm.columns`] multiplies."""
        values = []
        for m, c, i in zip(self.mass, self.centre, self.inertia):
            about = i + m * (c.dot(c) * numpy.eye(3) - numpy.outer(c, c))
            values += [m, *(m * c), *about[numpy.triu_indices(3)]]
        return numpy.array(values)

    def errors(self, q, v, a, torque, gravity, geometry=None):
        """RMS error of each joint that the best parameters and friction of all joints leave, relative to its RMS torque."""
        some = slice(None, None, max(1, q.shape[1] // 400))
        q, v, a, torque = (x[:, some] for x in (q, v, a, torque))
        rigid, rows = self.columns(q, v, a, gravity, geometry), q.shape[1]
        own = numpy.zeros((self.n, rows, 5 * self.n))
        for k in range(self.n):
            sign = numpy.tanh(v[k] / .02)
            own[k, :, 5 * k:5 * k + 5] = numpy.stack([a[k], sign, v[k], sign * v[k] ** 2, numpy.ones(rows)], -1)
        size = numpy.sqrt((torque ** 2).mean(1))[:, None]
        columns = (numpy.concatenate([rigid, own], 2) / size[:, :, None]).reshape(self.n * rows, -1)
        wanted = (torque / size).reshape(-1)
        scale = numpy.sqrt((columns ** 2).sum(0))
        columns = columns[:, scale > 0] / scale[scale > 0]
        found = numpy.linalg.lstsq(columns, wanted, rcond=1e-7)[0]
        return numpy.sqrt(((wanted - columns @ found).reshape(self.n, rows) ** 2).mean(1))

    def friction(self, v, load):
        """Friction `[n, rows]` at the speeds `v` under the torque `load`."""
        out = numpy.zeros_like(v)
        for k in range(self.n):
            speed, sign = numpy.abs(v[k]), numpy.tanh(v[k] / .004)
            coulomb, viscous = self.coulomb[k], self.viscous[k]
            match self.law:
                case "plain":
                    out[k] = sign * coulomb + viscous * v[k]
                case "smooth":
                    out[k] = numpy.tanh(v[k] / .03) * coulomb + viscous * v[k]
                case "stribeck":
                    out[k] = sign * coulomb * (1 + .3 * numpy.exp(-speed / .05)) + viscous * v[k]
                case "power":
                    top = self.top_speed()[k]
                    out[k] = sign * (coulomb + viscous * top * (speed / top) ** .7)
                case "load":
                    out[k] = sign * (coulomb + .02 * numpy.abs(load[k])) + viscous * v[k]
        return out

    def description(self, folder, name, form, gravity, nominal, friction_model, changed=None):
        """Writes NAME.toml (and NAME.urdf) and returns the path. `changed` are other rows of geometry."""
        rows = changed or self.rows
        lines = [f'model = "{name}"', f'convention = "{"urdf" if form == "urdf" else "modified_dh"}"',
                 f"gravity_m_s2 = [{', '.join(f'{g:.6f}' for g in gravity)}]", "speed_levels = [0.1, 0.5, 1.0]",
                 f'friction_model = "{friction_model}"']
        if friction_model == "smooth":
            lines.append("smooth_speed_rad_s = 0.02")
        if form == "urdf":
            lines.append(f'urdf = "{name}.urdf"')
            (folder / f"{name}.urdf").write_text(self.urdf(rows, nominal))
        for k, (a_m, alpha, d_m, offset, kind) in enumerate(rows):
            slides, unit = kind == "p", "m" if kind == "p" else "rad"
            low, high = self.limits()[k]
            lines.append("\n[[joint]]")
            if form == "urdf":
                lines.append(f'name = "joint_{k + 1}"')
            else:
                lines += [f'type = "{"prismatic" if slides else "revolute"}"', f"a_m = {a_m:.6f}", f"alpha_deg = {alpha}",
                          f"d_m = {d_m:.6f}", f"theta_offset_deg = {offset}", f"position_min_{unit} = {low}",
                          f"position_max_{unit} = {high}", f"velocity_max_{unit}_s = {1.5 * self.top_speed()[k]}"]
            lines += [f"acceleration_max_{unit}_s2 = 30", f"gear_ratio = {60 if slides else 100}"]
            if nominal and form == "dh":
                m, c = self.mass[k], self.centre[k]
                i = self.inertia[k]
                lines += ["[joint.nominal]", f"mass_kg = {m:.6f}", f"centre_of_mass_m = {c.round(6).tolist()}",
                          "inertia_about_centre_of_mass_kg_m2 = { " + ", ".join(
                              f"{x} = {i[p]:.9f}" for x, p in zip(("xx", "xy", "xz", "yy", "yz", "zz"),
                                                                  ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))) + " }",
                          f"{'motor_inertia_kg' if slides else 'motor_inertia_kg_m2'} = {self.rotor[k]:.6f}",
                          f"friction = {{ {'f1_n' if slides else 'f1_nm'} = {self.coulomb[k]:.6f}, "
                          f"{'f2_n_s_m' if slides else 'f2_nm_s_rad'} = {self.viscous[k]:.6f} }}",
                          "warm_up = { b = 0.0, t1_min = 30, c = 0.0, t2_min = 3 }",
                          f"{'force_noise_n' if slides else 'torque_noise_nm'} = {.01 * self.scale[k]:.6f}"]
        path = folder / f"{name}.toml"
        path.write_text("\n".join(lines) + "\n")
        return path

    def urdf(self, rows, nominal):
        links, joints = ['  <link name="base"/>'], []
        for k, (a_m, alpha, d_m, offset, kind) in enumerate(rows):
            body = ""
            if nominal:
                i, c = self.inertia[k], self.centre[k]
                body = (f'<inertial><origin xyz="{c[0]:.6f} {c[1]:.6f} {c[2]:.6f}"/><mass value="{self.mass[k]:.6f}"/>'
                        f'<inertia ixx="{i[0, 0]:.9f}" ixy="{i[0, 1]:.9f}" ixz="{i[0, 2]:.9f}" iyy="{i[1, 1]:.9f}" '
                        f'iyz="{i[1, 2]:.9f}" izz="{i[2, 2]:.9f}"/></inertial>')
            links.append(f'  <link name="link_{k + 1}">{body}</link>')
            alpha, offset = math.radians(alpha), math.radians(offset)
            frame = turn_x(alpha) @ turn_z(numpy.array([offset]))[0]
            pitch = math.asin(max(-1, min(1, -frame[2, 0])))
            if abs(math.cos(pitch)) > 1e-9:
                roll, yaw = math.atan2(frame[2, 1], frame[2, 2]), math.atan2(frame[1, 0], frame[0, 0])
            else:
                roll, yaw = math.atan2(frame[0, 1] * math.copysign(1, pitch), frame[1, 1]), 0
            low, high = self.limits()[k]
            joints.append(
                f'  <joint name="joint_{k + 1}" type="{"prismatic" if kind == "p" else "revolute"}">'
                f'<parent link="{"base" if k == 0 else f"link_{k}"}"/><child link="link_{k + 1}"/>'
                f'<origin xyz="{a_m:.6f} {-math.sin(alpha) * d_m:.6f} {math.cos(alpha) * d_m:.6f}" rpy="{roll:.9f} {pitch:.9f} {yaw:.9f}"/>'
                f'<axis xyz="0 0 1"/><limit lower="{low}" upper="{high}" effort="{9 * self.scale[k]:.3f}" '
                f'velocity="{1.5 * self.top_speed()[k]}"/></joint>')
        return '<?xml version="1.0"?>\n<robot name="drawn">\n' + "\n".join(links + joints) + "\n</robot>\n"
