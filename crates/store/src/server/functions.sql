-- Functions that statements and views of the store use and PostgreSQL has otherwise or not at all. They stand in the
-- schema of the program, which is looked through before the server's own.

-- Wall time, microseconds since 1970.
CREATE OR REPLACE FUNCTION clock_us() RETURNS bigint LANGUAGE sql VOLATILE PARALLEL SAFE
AS $$ SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000000 AS bigint) $$;

-- Wall time, seconds since 1970, whatever parts of a second are asked for.
CREATE OR REPLACE FUNCTION unixepoch(parts text) RETURNS double precision LANGUAGE sql VOLATILE PARALLEL SAFE
AS $$ SELECT CAST(extract(epoch FROM clock_timestamp()) AS double precision) $$;

-- Microseconds since 1970 as views show them: 2026-01-05T06:00:00.000Z. Rounded to the millisecond as SQLite rounds,
-- which counts days from the noon of 4714 BC in floating point.
CREATE OR REPLACE FUNCTION time_text(microseconds bigint) RETURNS text LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$
    SELECT to_char(
        timestamp '1970-01-01'
        + (trunc(CAST(microseconds AS double precision) / 1000000.0 * 1000.0 + 210866760000000.0 + 0.5)
           - 210866760000000.0) * interval '1 millisecond',
        'YYYY-MM-DD"T"HH24:MI:SS.MS"Z"')
$$;

-- Whether a text is JSON; one that is not is an error that says where.
CREATE OR REPLACE FUNCTION json_valid(content text) RETURNS boolean LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT CAST(content AS json) IS NOT NULL $$;

-- Elements of a JSON array, numbers and texts alike as texts.
CREATE OR REPLACE FUNCTION json_each(content text) RETURNS TABLE (value text) LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT value FROM json_array_elements_text(CAST(content AS json)) $$;

-- The larger of some numbers; NULL if one of them is.
CREATE OR REPLACE FUNCTION max(a bigint, b bigint) RETURNS bigint LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT greatest(a, b) $$;
CREATE OR REPLACE FUNCTION max(a bigint, b bigint, c bigint) RETURNS bigint LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT greatest(a, b, c) $$;
CREATE OR REPLACE FUNCTION max(a double precision, b double precision) RETURNS double precision
LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT greatest(a, b) $$;

-- Where a text begins in another one, from 1; 0 if it is not there.
CREATE OR REPLACE FUNCTION instr(content text, part text) RETURNS integer LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT strpos(content, part) $$;

-- Bytes as hexadecimal digits.
CREATE OR REPLACE FUNCTION hex(bytes bytea) RETURNS text LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT upper(encode(bytes, 'hex')) $$;

-- The present time in the form of the views. No statement uses another form or time.
CREATE OR REPLACE FUNCTION strftime(form text, moment text) RETURNS text LANGUAGE sql VOLATILE PARALLEL SAFE
AS $$ SELECT time_text(clock_us()) $$;

-- Random bytes.
CREATE OR REPLACE FUNCTION randomblob(bytes integer) RETURNS bytea LANGUAGE sql VOLATILE PARALLEL SAFE
AS $$
    SELECT substring(decode(string_agg(replace(CAST(gen_random_uuid() AS text), '-', ''), ''), 'hex') FOR bytes)
    FROM generate_series(1, (bytes + 15) / 16)
$$;

-- Whether a column of a view equals a value that was given as a text, and as a number where it is one.
CREATE OR REPLACE FUNCTION equals(content text, text_value text, number double precision) RETURNS boolean
LANGUAGE sql IMMUTABLE PARALLEL SAFE
AS $$ SELECT content = text_value $$;
CREATE OR REPLACE FUNCTION equals(content double precision, text_value text, number double precision) RETURNS boolean
LANGUAGE sql IMMUTABLE PARALLEL SAFE
AS $$ SELECT content = number $$;
